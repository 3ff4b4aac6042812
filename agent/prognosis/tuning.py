"""Tuned numbers of prognosis: name, value, unit, and why."""

# change.py
MEANS = 32  # means that the change is asked of
ASKED = 0.01  # level of each of two questions: a history without a trend has one less than once in 20
FEWEST = 6  # means from which laws are sought; of fewer only a line is
LINE = 3  # rows below which there is no line with an interval
SEASONAL = 0.7
"""Years of history from which on a yearly season is thought of, and the share of the year's months in which
there must be readings: a curve through two months of it is any course there is."""
SHARES = (0.6, 0.06, 0.04, 0.02, 0.15, 0.09, 0.04)
"""Prior probability of each shape: white, three of exp(−|Δt|/τ), a random walk, white beside two walks."""
LEAST = 0.01  # least sd of a reading, in that of neighbours' differences: none is exact
# crossing.py
NEXT = 5  # rows of which a row that lies beyond a limit is the first
NEEDED = 3  # of these, so many must lie beyond it: one outlier is no passage
DRAWS = 40  # equally probable draws that stand for a forecast's thousands
DRAW_DIGITS = 6  # digits of a stored draw
# family.py
LEAST_LEFT = 0.05  # share of the way below which what is left counts as no shorter
STEEPEST = 30.0  # |κ| and exponents beyond this are cut: exp(30) is past every rate there is
# forecast.py
SPANS = 3.0  # P90 − P10 in spans of the history from which on a history is too short to say
RATIO = 4.0  # and P90 : P10, so that what is near is not called unknown
NEWEST = 3  # newest means that say that a limit is crossed before any law is sought
SURE = 2.0  # sds of these by which they must lie beyond it; else the laws say how probable that is
SEED = 15  # any does
LEVELS = 250  # draws of the newest level at which like machines are looked at
LEAST_WAY = 0.5  # of the way to the limit that a like machine must show to say how long the rest takes
# history.py
NEIGHBOURS = 5  # rows on each side that a row is compared with
OUTLIER = 5.0  # robust sds from its neighbours' median at which a row is an outlier (Hampel 1974)
# learnt.py
COUNT = 1.0  # machines that the usual spread between machines counts for
LIGHT = 2.0  # degrees of freedom beyond that: with fewer than three, draws reach past any machine
SEEN = (0.3, 0.5, 0.7, 0.9)  # shares of a life at which laws are learnt
LATER = 0.7  # spread of what κ differs by later before any machine is seen
WANDER = 10.0  # a rate that wanders by ω over a life moves the way gone by about ω/10 from its law in between
# passage.py
FARTHEST = 20.0  # how many spans of the history ahead paths are followed
# posterior.py
AT_ONCE = 24_000
"""Readings, times particles, whose numbers are made at once: more leave the processor's cache (all took 12 MB
of a gateway's memory), and of fewer the calls cost more than the numbers."""
WITHIN = (-40.0, 25.0)  # logarithms that a proposal may reach; beyond, numbers overflow
RUN_IN = 50.0  # how freely the rate wanders while a part runs in, in usual rates over a span
COUNTED = 1.0 / 11.0  # of the particles that need count for the next round: with more hundreds stay put
STEADY_ODDS = 0.3
"""Odds of a steady rate from which on it is taken for steady. Less, and cracks at half of their lives count
as steady; more, and a steady fall's band is that of laws that bend too little to be seen."""
SELECTION_POWER = 6.0  # of these odds: one is a mixture's; a threshold would let bands leap from row to row
GONE_POWER = 4.0
"""Power of the way gone over the way left by which these odds are less before half of the way: parts that
level off look steady at two fifths."""
# steps.py
PARTS = 200  # means that a history is thinned to where steps are looked for
ASIDE = 3  # means on each side of an instant that are held against each other
APART = 7.0  # sds of that difference, as it scatters over the whole history, from which it is a step
MOST_TAKEN = 5  # steps that are taken out, the largest
MANY = 3  # steps of one direction from which on they are how the part wears
# traces.py
POINTS = 32  # points of a trace that are evenly spread in time, and as many in level
SHORT = 0.05  # of the way that a trace may end before a limit and still say when it would reach it
SPREAD = 0.3  # spread between machines of a kind before any is seen, in natural logarithms of a time
PERSISTS = 0.5  # how much of a pace persists before any machine is seen, and how sure that is
UNSURE = 1.5  # sd of the spread's logarithm before any machine is seen: three are to settle it
OTHER = 1.0  # spread of a machine of another kind about these, in the same
ALIKE = 0.8  # how probable it is beforehand that a machine is of the kind of those it is compared with
QUARTERS = 4  # equal times whose ways are compared with those of like machines
SHORTEST = 1e-3  # share of the time so far below which a time counts as no shorter
