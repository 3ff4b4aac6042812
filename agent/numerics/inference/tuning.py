"""Tuned numbers of the statistical model: one table, each with its unit, its source and what needs it.

Every number is a prior or a numerical tolerance of the model in `agent.numerics.inference`; none is a limit
on a verdict of its own. "Needed by" names the row of docs/statistics.md that fails without it.
"""

SIGMA_SPREAD_UNSTATED = 5.0
"""Prior sd of log σ where no noise_sd is stated: nothing is known. Needed by: white noise to be learnt."""
SIGMA_UNKNOWN = 1.0
"""Prior sd of log σ beyond which it counts as unknown when intensity grids are laid out. Needed by: EMPS."""
DIGITS = 1e-7
"""Least σ as a share of a signal's spread: 23 bits, more than a sensor has. Needed by: no noise at all."""
STANDING_WEIGHT = 0.1
"""An interval holds 95 % under each hypothesis that stands: of at least this share of the likeliest's weight.
Needed by: both masses +10 %, rig 8805."""

POSSIBLE = 0.01
"""Weight, of the likeliest's, from which a window is made straight at a hypothesis. Needed by: rig 8805."""
NEAR = 0.1
"""Twice the log evidence that neglected terms of second order may cost a hypothesis in a window, about where
the window is straight. Needed by: rig 8805."""
PLACES = 12
"""Most such places besides the first, the likeliest hypotheses' first. Needed by: rig 700103."""

DELAY_SHEET = 0.25
"""Data-sheet sd of the input delay, samples, if unstated. Needed by: force not straight between samples."""
CURVE_SHEET = 1.0
"""Prior sd of what a smooth force does beyond straight lines (1: all). Needed by: few samples a period."""
CURVED_A_PERIOD = 15.0
"""Samples a period of the fastest mode below which it is open. Needed by: unknown machines (31 of 40)."""
AS_CONFIGURED = 0.02
"""Hypothesis "as configured" means this share of the data-sheet sd: right for all that can be measured."""
AT_ONCE = 2e-5
"""... of how late one output is read: at once, in all hypotheses but those that say that it is not. With the
share above rows of a loud window are half as wide again as it says itself, or cost one column an output."""
SHEET_FACTORS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Factors on all data-sheet sds, a hypothesis each, the last where there are several masses. Needed by: all
constants off within their data sheet; m2 -20 % and both outputs -10 %."""
OFF_RELATIVE = 0.3
"""Prior sd of a mass or gain that is "off". Needed by: m2 −20 %."""
OFF_DELAY = 1.0
"""Prior sd of a delay that is "off", samples. Needed by: held but hold = "first" (half a sample)."""
OFF_CUBIC = 0.1
"""Prior sd of by how much a spring hardens, share of its stiffness at the first window's rms extension.
Needed by: springs that harden by 5 %."""
STRAIGHT = 1e-13
"""Share of OFF_CUBIC by which springs are straight in all hypotheses but those that say that they are not:
with more, precise sensors would tell scales apart that no reading shows. Needed by: all masses, rig 7404."""
HARD_EVIDENCE = 10.0
"""Log evidence from which a broken window is learnt from in case springs harden. Cost only."""
SETTLED, SELDOM = 4, 8
"""First windows in which springs that harden are looked for with a noise of their own; and of later ones, in
which nothing hints at them, one in so many. Needed by: one mass, k1 +10 %."""
WIDER = 4.0
"""Ratio of mean square extensions from which the cube of a spring counts by the wider one."""
PRIOR_CUBIC = 0.01
"""Prior odds that springs harden or soften, against straight ones. Needed by: springs that harden by 5 %."""
DRIFT_WALKS = (0.0007, 0.005)
"""Random walks a window of a gain that "drifts", slowly or fast. Needed by: sensor y1 drifting 5 %."""
PRIOR_DRIFTS = 0.003
"""Prior probability that a gain drifts, as a share of that it is off. Needed by: not straight."""
DRIFT_FOLLOWED = 0.2
"""Probability of any drift from which every window is learnt from. Needed by: sensor y1 drifting 5 %."""
QUIET_WALK = 1e-4
"""Random walk a window of constants that do not drift, in data-sheet sds: keeps covariances from closing."""
SWITCH = 1e-3
"""Chance a window that another hypothesis on the constants becomes the true one."""
PRIOR_LATE = 0.002
"""Prior odds of inputs as late as their data sheet lets them, against in time: half a sample (two sds) is
named, a tenth of one is not. Needed by: late, hold zero."""
PRIOR_WIDER = 0.35
"""Prior odds that all data sheets are three times too narrow, against as stated; and ten, against three.
Needed by: one mass +8 %."""
WORTH_NAMING = 0.1
"""Share of its data sheet by which a gain that drifts must be off to be named. Needed by: rig 30138."""
BARE_MENTION = 4.0
"""Ratio of probabilities below which explanations share them: of 500 random rigs two stood at 3.0 and 3.5 for
a sound part. Needed by: one output of a single sensor, rig 950140."""
PRIOR_HEALTHY = 0.7
"""Prior probability that every constant is within its data sheet."""

JUMP_LEVEL = 1e-6
"""False-alarm probability of the test of a jump in a window. Needed by: 0 false `changing` in 10,000 hops."""
MISMATCH_SD = 5.0
"""Predictive standard deviations beyond which a window's residual power is not explained by the model."""
CUTS = (0.125, 0.375, 0.625, 0.875)
"""Places inside the window at which a jump is tested, as shares of it."""

INFORMATION_LOSS = 0.01
"""Share of any parameter's sd that may be given up by leaving out columns at high frequencies."""
STEP_RATIO = 0.7
"""Ratio of steps beyond which they hardly shrink. Needed by: a delay that a damper hides, without mass."""
HALVINGS = 8
"""Most times that a Gauss-Newton step that does not lower the cost is halved. Needed by: EMPS."""
STEPS = 12
"""Most Gauss-Newton steps of one window."""
CONTINUATION = (1.0, 0.3, 0.1, 0.01, 0.0)
"""Shares of the whole motion that unknown forces may be, one after another, where a first window does not
come to rest. Needed by: all masses -20 %, three masses (rig 701415); one mass +16 % (rig 980113)."""
ASTRAY_SD = 100.0
"""Sds of the constants' prior from which such a start has lost its way: it may wander and come back."""
ALTERNATIONS = 3
"""Most turns of noise and descent in a first window that does not come to rest. Needed by: rig 9250."""
CURVATURE = 0.03
"""Linearised again where the neglected second-order term, step², exceeds this share of the sd."""
STAYS = 0.05
"""Share of what a model is straight within by which its point may be off before it moves. Cost only: a
tenth of what learning takes, for a thousandth of an sd; 0.25 moves precise estimates by a third."""
LONGEST_STEP = 0.5
"""Longest Gauss-Newton step downwards, as a share of the parameter (twice that upwards)."""

JACKKNIFE_BLOCKS = 8
"""Blocks left out in turn. Needed by: recorded machines, whose model error is common to adjacent samples."""
SCATTER_PRIOR_DOF = 4.0
"""Degrees of freedom of the first belief that scatter is the model's. Needed by: first windows of ECP-210."""
SCATTER_MOST_DOF = 160.0
"""Most degrees of freedom carried: about 23 windows of 7."""
BETWEEN_DOF = 40.0
"""Memory of scatter between windows, windows. Needed by: ECP-210, whose dampers are friction equivalents."""
ROUNDS = 6
"""Most times that one window is linearised anew because the constants moved. Needed by: m2 −20 %."""
FAR_TOLERANCES = 1.0
"""Tolerances beyond which constants have moved so far that the window is done again."""
AGREE_SD = 3.0
"""Sds within which a window's estimate and the point of linearisation agree."""
STEADY_WALK = 0.1
"""Variance by which parameters may differ from those of windows before, in that of a window's estimate."""
POINT_SD = 1.5
"""Relative prior sd of the next point about the last. Needed by: standstills in normal operation."""
POINT_MEMORY = 0.75
"""Share of the last point's information that the next keeps where a window agrees: about four windows."""
LEAST_CHANGES = 20
"""Sensor-code changes below which a window is a standstill, teaching nothing. Needed by: ECP-210, clamped."""
STANDSTILL_SD = 4.0
"""Sds of its own chance by which a window's spread may exceed the noise alone. Needed by: standstill."""
LINE_SD = 0.3
"""Prior sd of a parameter's change in a window, shares of it. Needed by: a spring that softens in seconds."""
CREEP = 0.02
"""Share of the greatest speed below which a speed's sign is unknown. Needed by: EMPS without its friction."""
FRICTION_EVIDENCE = 12.0
"""Log Bayes factor from which dry friction is believed: against 1 : 10,000. Needed by: EMPS, no friction."""
EXPLAINED_SD = 2.5
"""Predictive sds within which an explanation leaves noise. Needed by: a bias that begins inside a window."""
CHANNEL_EVIDENCE = 9.2
"""Log odds, 99 : 1 after 100 looks, by which a channel must lead all else. Needed by: forces that begin."""
WORTH_MENDING = 60.0
"""Linearised log evidence behind the best channel beyond which an explanation is not followed. Cost only."""
MENDINGS = 8
"""Most times that a window is mended and looked at again. Needed by: channels that come 40 samples late."""
STOOD_SHARES = (1.0, 0.3, 0.1)
"""Sizes of the force in place of a frozen input, shares of what it was. Needed by: a force that freezes."""
NOISE_PRICE = 7.6
"""Log evidence a noise change costs: two numbers of a 2000-reading window. Needed by: forces that begin."""
FINE_CUTS = 16
"""Parts of a window between which a change is looked for, where forces might be it. Needed by: k1 -5 %."""
MANY_TIMES = 4.0
"""Factor from its nominal at which a parameter competes with a channel that is wrong from the start, and from
the measured forces beyond which unknown ones explain nothing. Needed by: millimetres against metres."""
AS_LARGE = 0.3
"""Share of the inputs' sd at which unknown forces do. Needed by: a channel 20 samples late from the start."""
LARGER = 0.5
"""The same where a first window waits a quarter of a window more, in which a channel can show it is late:
EMPS has 0.40 to 0.47 of forces that are its model's. Needed by: a channel 20 samples late from the start."""
FIRST_EVIDENCE = 20.0
"""The same as CHANNEL_EVIDENCE in a first window, against forces that were never seen before. Needed by: a
channel 20 samples late from the start (leads by 30 to 80 nats), AR(0.99) 0.05 N (by 16 at the most)."""

# noise
SIGMA_WALK = 0.1
"""Prior sd of log σ's random walk from window to window. Needed by: jitter, whose noise grows with speed."""
SIGMA_WALK_DOF = 4.0
"""Windows this prior counts for; what windows then show falls to 0.03 on a steady rig. Needed by: jitter."""
LEVEL_DOF = 30.0
"""Prior degrees of freedom of each frequency bin's noise level (scaled inverse χ²). Needed by: 50 Hz hum."""
LINE_POWER = 16.0
"""Power of a bin, in that of its neighbours, from which it is a line: chance e^-16. Needed by: 50 Hz hum."""
LINE_NEIGHBOURS = 25
"""Bins on either side of a line that it is held against."""
LINE_CYCLES = 8
"""Cycles a window that a line has at least: what is slower is the work of forces."""
FORGET = 0.97
"""Factor a window on the log-weights of force and colour intensities. Needed by: forces that begin."""
UNSETTLED = 0.05
"""Change of an intensity's logarithm from which every window is learnt from. Needed by: forces that cease."""
LARGE_NODES = 20.0
"""An intensity beyond this many first nodes is followed so: a weak one moves by chance. Cost only."""
SURE = 3.0
"""Log-weight of "absent" below the best node from which an intensity that changes is followed. Cost only."""
NODES = 44
"""Nodes of the grid of each intensity; fewer stop short of the forces of EMPS. Needed by: EMPS."""
NODE_RATIO = 1.6
"""Ratio of adjacent nodes: a quarter decade, finer than a window tells intensities apart (log sd ≥ 0.3)."""
FIRST_NODE = 0.1
"""First node as a share of the intensity that equals the white sensor noise where the source is strongest."""
LOWEST_LOG_WEIGHT = -30.0
"""Floor of carried log-weights: the chance that an intensity jumps anywhere in a window is e^-30."""
ROTATION = 3
"""Intensities scanned in a window besides the active ones. Cost only: every one has its turn, and of 58
cases none holds more or less by a per cent than where six or all are scanned."""
ACTIVE_NODES = 5.0
"""An intensity beyond this many first nodes is scanned in every window."""
PRIOR_ABSENT = 0.5
"""Prior probability that a source of noise is absent. Needed by: right models near the bound."""

# spectral
SENSOR_CORNERS = (0.05, 0.01, 0.002)
"""Corners of coloured sensor noise, shares of the sampling rate. Needed by: AR(0.95) sensor noise."""
FORCE_CORNER_OF_SLOWEST = 0.5
"""Lowest corner of slow unknown forces, share of the slowest mode's frequency. Needed by: AR(0.99) forces."""
FORCE_CORNERS = (1.0, 4.0)
"""Corners of slow forces, in units of the lowest: one alone fits no other. Needed by: AR(0.99) forces."""
MOST_BINS = 2048
"""Most bins kept with all columns, and most bins above the cut whose residual power is used."""
HIGH_GROUPS = 16
"""Groups of bins above the cut: noise is taken as flat within each (a twelfth of a decade)."""
ALL_BINS = 24
"""Windows with fewer bins than this keep them all."""

# channels, friction, learner, mixture
RESTS_SD, RESTS_SAMPLES = 0.3, 0.6
"""Sds of an offset or a gain, samples of a delay, below which what is left of it is not mended further."""
FLAT = 1e-6  # prior precision of a free parameter: within a thousand times itself
LEAST_FACTOR = 1e-9  # a gain that would mend a reading by less than this has no reading left
UNSEEN = 1e-9  # share of a column that must be left beside the model's own for it to have digits
FIRM = 1e6
"""Times as many degrees of freedom behind the level of each bin as were seen: one window moves none."""
NOISE_PASS = 2  # what learning the noise of a window costs, in evaluations of the model
LOOKS_AN_EVALUATION = 3  # steps of joint fits, and grids looked at, that cost as much (0.7, 1.4; 2.7 ms)
LEAST_WEIGHT = 1e-4  # components below this weight do not move a 2.5 % quantile

# noise/rounding
MOST_DIGITS = 5  # significant digits at most that a table is taken to be rounded to: a millionth is no noise
ROUNDING = 1e-6  # of a step by which a decimal number may miss a whole number of them: doubles miss by 1e-11
MOST_REPEATS = 32  # of one code that count: what stands still longer is told by the changes of codes
LEAST_OWN = 0.01  # of the variance that is assumed, at least: what is not rounding stays

# noise/after_window, intensities, lines, restricted_likelihood
FIRST_STEPS = 12  # most scoring steps of log σ in a first window, by 1 at most each
DROWNED = 1e-7  # share of the residual's power that must be left for a rank-one change of S to have digits
FAR_GROWTH = 1e6
"""Growth of S along a source beyond which it is inverted anew: a rank-one change leaves too few digits."""
FREE_BINS = 3  # bins of a rig with a free mass that do not count for where a force shows
LEAKAGE_ROUNDS = 4
"""Times that lines are looked for: beside a strong one weaker bins of its leakage stand out next."""
SHOWN_PERIODS = 1.0
"""Periods of the slowest colour that a window must hold for colours to be sought together, and to have ends.
Needed by: adhesive joint 004 and MR damper, whose model error passes for colours in shorter windows."""
PIVOTS = 100  # most rounds in which variances that would fall below 0 are found; it takes two or three
GROWTH = 8.0  # times the largest intensity's variance that a source's may be after a scoring step
RESTING = 0.01  # step of log σ at which scoring rests

# spectral/algebra, response
JITTER = 1e-13  # added to unit diagonals: a direction that the data do not show at all stays finite
ON_A_POLE = 1e-8
"""Bins nearer than this to a pole are left out: their response has too few digits. Measured, noise-free:
entries of random systems with a pole at 1 come out to 4e-6 at 1e-9, to 3e-11 from here on."""
FREE_SHARE = 1e-6  # singular values of I − A^W below this share of the largest are those of free masses
