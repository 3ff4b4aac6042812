"""Tuned numbers of references: name, value, unit, and why."""

# covariates/dependence, lags, regression
STRANGE = 0.5  # how far a dependence may be off beyond what was learnt, as a share of what it adds there
STEPS_A_SPREAD = 4.0  # steps of a reference in the healthy spread: finer ones say no more, for a row each
LITTLE = 0.5  # share of what acts of a covariate below which it counts as missing
OUTSIDE = 0.1  # by how much of the learnt range a covariate may be beyond it before that is said
CLOSED = 2  # periods by which a row's means are older: readings may come late, and no row differs
RECENT = 2880.0  # periods (two days) over which a covariate is averaged to guess it while it is missing
DRIFTS = 10_080.0  # periods (a week) after which that guess is off by sqrt(2) of the covariate's spread
UNREAD = 129_600  # periods (90 days) for which a covariate counts as missing that was never read
MOST_GAP = 20_000  # periods without a row after which a lagged covariate is begun anew (two weeks)
CORRELATIONS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99)
"""Autocorrelations from period to period that are weighed."""
SHORTEST_S, LENGTHS, PART = 300.0, 17, 8.0
"""Lags are 5 min times the square root of 2 to the 0 ... 16 (21 h), at most an eighth of the stretch."""
ROUNDS = 2  # how often each covariate's lag is looked for beside those of the others
CLIPPED = 3.0  # robust deviations at which a period's residual is cut, so that a bad hour moves nothing
ALIKE = 0.999  # correlation of two covariates from which on nobody can tell which of them it is

# limits, spread
FOUND = 0.9  # probability with which a change of the size said is found within the time said
WORTH = 1.05  # a longer delay is worth its time where what it finds is smaller by this ratio
SURE = 0.95  # confidence at which a spread of few independent hours is not larger
MARGIN = 0.5  # least limit in sd of a row: below that the alarm would stand on the confidence alone
OUTLIER = 5.0  # robust deviations from its period's median at which a row is left out of the mean
LEAST_DAYS = 3
LEAST_PAIRS = 4  # days that a spread between days needs, and pairs of means that an autocorrelation needs
