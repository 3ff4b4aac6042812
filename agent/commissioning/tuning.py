"""Tuned numbers of commissioning: name, value, unit in the name or the words, where from, and what needs it.

The tests that need these are tests/unit/commissioning (checks, channels, observer).
"""

# ------------------------------------------------------------------ listening to sources
LISTEN_S = 5.0  # how long is listened, counted from when every source has been heard
ABSENT_S = 3.0  # how long a source that cannot be opened may take to come up
PATIENCE_S = 5.0  # how long a source may take until its first sample
TURN_S = 0.1  # how long is waited for arrivals at a time
OFF_RATE = 0.02  # share by which samples may come faster or slower than configured
DRIFTS_PPM = 200.0  # a clock that surely drifts by more is worth a word

# ------------------------------------------------------------------ noise of channels, from readings
ORDER = 6  # of the difference that takes out the motion and leaves the noise
REACH = 24
AHEAD = 2  # readings of a force that may show in one of an output, and how many come after it
LEAST_ROWS = 10
MOST_ROWS = 50_000  # rows for each number that is fitted, and of all that is gone by
CALM = 0.2  # of an input's rms: what differences leave beyond is no noise but the force itself

# ------------------------------------------------------------ channels that may be exchanged, scaled or late
LEVELS = 10  # different readings that two channels must show: coarse ones may well agree on fewer
STRETCHES = 2  # stretches of a recording that are examined, those that move most
PLAINER = 2.0  # a zero, a scale or a delay must leave less than this part of what mended wires or signs leave

# ------------------------------------------------------------------ what windows will tell
FORCE_RMS = 1.0  # N (or the input's own unit): what is assumed where no recording says how the rig is excited
DECAY_FROM = 0.01  # m (or the state's own unit): where a rig without a measured force is let go
GUESSED_NOISE = 1e-3  # of an output's rms, where nothing is known of its noise
MOST_GROWN = 1e12  # a model whose motion grows so many times within a window is no prediction's business
SETTLE_MOST = 50_000
SPAN_MOST = 40_000  # samples that are simulated until motion has settled, and beyond the longest window

# ------------------------------------------------------------------ warnings
MARGINAL = 1e-9  # a pole this near the unit circle neither decays nor grows
FEW_A_PERIOD = 20  # samples a period below which a straight line between samples is not what a force did
FEWER_A_PERIOD = 8  # samples a period below which a cubic is not either
LIVELY = 1e-3  # damping ratio above which a mode that oscillates counts as one with a period worth a window

# baseline/covariates, learn, limits, tried
HELD_TIMES = 3  # times between readings for which the last one stands
PRESENT = 0.5  # share of the periods with rows in which a covariate must be known
EDGES = (0.005, 0.995)  # quantiles of what was learnt, and of a history whose range nothing states
ROWS_TRIED = 5000  # rows that limits are tried on at a time: 10 MB
LEAST_PERIODS = 24  # periods that a baseline needs: the spread of fewer is known to no better than a fifth
DOUBTFUL_PERIODS = 5.0  # independent periods below which what was learnt may be a drift
RESOLVE = 0.33  # what `estimator.resolve` is by default
ORDINARY = 0.9  # share of rows that must not become unexcited by a limit
PER_YEAR = 1.0  # false alarms a year that a limit may cost
LITTLE_HOURS = 10.0  # independent hours below which the spread itself is hardly known
NEAR_NS = 10_000_000_000  # two activations are of one event where no more than this lies between them

# check, recorded_windows
WORST_ROUNDS, OBSERVER_ROUNDS = 8, 3  # line searches for the worst point; the observer's cost exponentials
WEAKEST = 1.0  # sd of a change, in sizes of the parameters, beyond which a window does not tell it
SEEN_WINDOWS = 5  # of a recording that are looked at
NOISE_OF_MORE = 1e-3  # noise of an output that is not there yet, as a share of what it would read
SHARE_OF_MORE = 1e-2  # the same of one that would show what windows leave vague

# excitation/excite, lines
MOST_SAMPLES = 400_000  # of a signal or recording: each sample's information is computed one by one
SHOWN_SHARE = 0.05  # share of the power from which a line is named
MOVING_TIMES = 3.0  # times the noise of its sensor that a motion must be to be one
ROUNDING = 1e-9  # of a reading: what is less is no motion but arithmetic
SIGNAL_DIGITS = 9  # digits of a signal that is written: more than any generator has
MOST_LINES = 500  # frequencies, an input; beyond, they are spaced by ratios, closer about the modes
ABOVE, BELOW = 2.5, 0.3  # the band by default: times the fastest mode, and share of the slowest
HIGHEST = 0.4  # of the sample rate: faster forces are no straight lines between samples
BANDWIDTHS, NEAR_LINES = 6.0, 61  # half-power bandwidths about a mode where lines are closer, and lines

# numerics/design
DESIGN_ROUNDS = 20_000  # steps of the algorithm; it gains a third of the gap each time they are doubled
GAP = 2e-4  # share by which d may exceed q: by so much of the power the same could be had for less
CHECK = 50  # steps from one look at the gap to the next
LITTLE = (1e-5, 1e-6, 0.0)  # of the greatest power: lines below are left out; the next where that costs
# numerics/multisine
PASSES = 300  # rounds of clipping
CLIPPED = (0.85, 0.98)  # share of the peak at which is clipped, in the first round and the last

# graphs/choose
LEAST_WINDOWS = 8  # windows that the jackknife needs
TINY, SMALL = 1e-3, 0.02  # of the largest of its kind: elements of the file, and proposed, below begin at 0
GRAPH_ROUNDS = 8  # graphs that are fitted in turn
LISTED_GRAPHS = 8  # graphs beside the chosen one that are shown

# identification/doubts, material, rivals, start, units, windows
UNEXPLAINED = 0.02  # share of a motion, without noise, beyond which the graph is not the machine's
PULLED = 5.0  # data-sheet sds beyond which a mass or gain that the data ask for is no mass or gain
VAGUE = 0.33  # sd, as a share of the value, above which a parameter is not known
INSEPARABLE = 0.95  # correlation from which two vague parameters are named together
SHORTEST_PIECE = 128  # samples without a gap that a piece of a recording has at least
EVIDENCE = 6.9  # log likelihood beyond which one of two solutions is evident: 1000 : 1
APART_SD = 3.0  # standard deviations beyond which two values of a parameter are two
APART_SHARE = 0.1  # share of a motion by which two solutions differ where a sensor tells them apart
LEAST_START = 1e-4  # of the largest of its kind: what a start is where noise made it negative
LEAST_SAMPLES = 2048  # samples that are looked at, where a quarter of a recording is less
UNIT_FITS = 0.1  # share of a channel's motion that a start may leave: with wrong units it leaves most
PERIODS, WINDOWS, LONGEST = 10, 12, 32_768
"""Periods of the slowest mode in a window, windows of all recordings if possible, most samples per window."""
FIRST_PERIODS, GROWTH = 2, 6
"""Periods of the fastest mode that oscillates in the first windows of a linear model, and how many times
longer the next ones are."""
AT_ONCE = 1e-4  # for a sampled pole at 0, whose motion dies within a sample and whose rate has no log

# regions/picture, places
LEAST_SIDE = 0.02  # of the frame of the poles: a pole on the real axis has no height
DRAWN_POINTS = 200  # points of the box whose poles are drawn
GRID = 25  # points along each side of the plane
BEYOND_BOX = 3.0  # half boxes that the plane reaches: what holds within the limits shows more around

# numerics/motion/exact_response
LONGEST_PIECE, MOST_PIECES = 16_384, 6  # samples of a piece, and pieces: the start needs no more
MOST_KEPT = 1200  # frequencies of a piece that are kept
FIRST_STEPS, FINALISTS = 5, 2  # steps after which the starts are compared, and how many of them go on
MOST_ROUNDS = 20  # steps of those that go on ...
RESTS_SHARE = 1e-2  # ... which rest where a step changes no parameter by this share ...
HOPELESS = 1e6  # ... and end where it was damped by so much
NEIGHBOURS = 15  # frequencies over which the errors' power is averaged
NEAR_POWER = 2.0
"""Logarithm of the errors' power by which another minimum may leave more: masses a few percent off leave as
much of the right one."""
STRETCH = 0.7  # logarithm by which a step changes a parameter at most
VAGUE_LOG = 3.0  # sd of what is known of a parameter's logarithm before: what no bin shows stays within it
# numerics/motion/first_noise
TAUGHT = 3  # windows the noise is learnt from: learning from one costs a hundred times reading it
BRIEF, BRIEF_SHARE = 512, 0.1  # samples, and share of a window, of the first look at the least
FROM = 2  # windows from which that is done: one alone may rest, and is learnt from as a whole
SEARCHED = 3  # windows behind a noise whose sources are not sought on all of their grids any more
# numerics/motion/modulation
FASTEST = 0.7  # of half the sample rate: beyond it what a force does between samples shows in other bins
# numerics/motion/pooled
FARTHEST = 10.0  # data-sheet sds that a constant may move: beyond, the graph does not fit
MOST_STEPS, RESTS_SD = 16, 0.05  # points that are looked at, and the step, in sds, at which they end
NEAR_SD = 0.5
"""The step in standard deviations that may be left when the points are over: it widens the interval. Where
determinants move the likelihood's top from where the sum rests, or a valley of what nothing tells is curved,
0.1 to 0.45 are left beside the truth; 0.9 and more were left elsewhere."""
WORSE, PATIENCE = 1.0, 3
"""Log likelihood, over the scatter, by which a point may be worse (determinants vary by as much), and steps
after which one of them has to be better."""
HELD = 1e12  # prior precision, in relative units, of what stays at its point while likelihoods are compared
# numerics/motion/response
PARTS = 4  # lengths into which a record is cut
SHORTEST_STRETCH = 64  # samples of a stretch at least
SMOOTH = 2  # order of the window: its sides fall off faster than a resonance does
MOST_BINS = 300  # bins of a response that are fitted
ROUGH, CERTAIN = 0.1, 0.5  # relative errors: what short stretches smear, and where a bin says nothing
STARTS = 32  # starts that are drawn at random ...
ROUNDS_OF_A_START = 30  # ... steps of each ...
SEED = 17  # ... and what they are drawn with: any does
FIRST_ROUNDS, FOLLOWED = 10, 12  # rounds after which guesses are compared, and how many go on
DAMPING = 0.05  # damping ratio of a guess
MOST_MINIMA, ALIKE = 6, 0.2
"""Minima that are looked at closely, and the logarithm by which parameters of one differ at most: damping is
seen less well, and tells no two apart."""
# numerics/motion/selection
LEVEL = 0.02  # chance that any element that is not there is taken for one that is
RIDGE = 1e-12  # of what is known of a parameter: what no window shows would have no answer without
TIE = 2.0  # difference of scores, natural logarithms, below which two graphs are close: odds of seven to one
# numerics/motion/start
SCALES = (1, 2, 4, 8)  # into how many lengths a record is cut; stretches overlap by half
WEAK_ROUNDS, RESTS = 20, 1e-4  # most rounds, and the change, as a share, below which they end
STILL_VARIANCE = 1.5  # variance of a motion, in that of its sensors' noise, below which nothing moves

# numerics/channel_constants
LEAST_SHARE = 1e-3  # of an output's rms: smaller differences are nobody's fault
WIDE = 50.0  # log likelihood by which a constant must beat the readings as they are
STILL = 5.0  # an output that does not rise over so many times its noise tells nothing
FITS = 1.5  # times the noise that a scale or a delay may leave: with more it may be something else
NEAR = 1.1  # constants that leave no more times what the best leaves cannot be told from it
MARGIN = 50  # samples at either end that delays are looked for within
# numerics/channel_scale
LEAST_SCALE, MOST_SCALE = 1e-9, 1e9  # factors beyond these are no channel's scale
# numerics/information
SINGULAR = 1e-14  # least eigenvalue of information of unit diagonal that says something, of the largest
# numerics/wiring
FACTORS = (2.0, 10.0, 100.0, 1000.0, 1e6, 25.4, 39.3700787, 9.80665, 4.4482216)
"""How many times too large or small a reading may be: twice, prefixes, inches, kilogram- and pound-force."""
BETTER = 2.0  # a hypothesis must leave less than this part of what the readings as they are leave
WORTH = 3.0  # explanations that leave more times the best's of a stretch are not tried further
EXPLAINED = 0.5  # share of an output that an explanation may leave at most

# progress
PROGRESS_WIDTH = 60  # characters that words of progress may take

# setup/listen, text
SHOWN_EVERY_S = 0.5  # s between good units shown, the newest of each kind; rejected ones are shown at once
MOST_BAD = 5  # rejected units of a source that are shown at a time
KEPT_LINES = 50  # lines that the document keeps, the newest
SLOW_HZ, HOP_SAMPLES = 40.0, 5.0  # below this rate rows come every so many samples, above it by default
