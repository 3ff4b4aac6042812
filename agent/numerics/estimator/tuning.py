"""Tuned numbers of the estimator: name, value, unit, and why."""

# bank.py
UNITS_LEAST = 32
UNITS_MOST = 2560
UNITS_GROWTH = 4
"""Hops that the bank is given at once: few after the operating point moved, which throws the rest away, then
so many times more; a call costs as much as 125 hops."""
UNITS_WAIT = 320  # hops that wait until the window before them was learnt from: one in two or three moves it
DULLED = 1.05  # growth of the sharpest sd with each move of the operating point, which follows the machine
# doubts.py
CONFIRMED_SD = 4.0  # sds within which the motion must find a suspect reading to confirm it
CONFIRMED_SPREAD = 0.06  # sd of its share besides: a half sine of four samples is 5 % from straight lines
# explainer.py
VERDICT_WINDOWS = 3  # learnt from before verdicts, first or anew: they tell of noise and constants at once
LEAST_LEFT = 0.5  # share of what is configured that a first window must leave, where it rests for half of it
REFILLS = 2  # times that suspect inputs are put where the motion asks for them before a window is solved
MOVING = 8  # what moving the bank costs, in evaluations
MOVED_SD = 0.3  # sds between learner and bank from which it moves: twice what omitted bins may make
MOVED_LOG_SD = 0.1  # the same for the logarithm of a sd
# faults.py
WHOLE = 0.8  # share of a window that lies behind the onset of what it is to show
AGREES_SD = 3.5  # sds within which a row agrees with what held before the fault
DOUBTS = 2  # tries in a row that do not confirm a fault, after which it is withdrawn
RESTS, MOST_RESTS = 4, 1000  # an input's rests of a window's 1 / RESTS that are remembered, at most
NOISY = 2.0  # times what the wire's resolution causes: a sensor with so much noise repeats nothing
WITHIN_SHEETS = 2.0  # sds of its data sheet by which a gain may change and is learnt, no fault of its channel
# memory.py
LEAST_WINDOWS = 4  # windows that must have been learnt from before it is worth keeping
# operating_point.py
IN_TIME = 2e-3  # samples: an output whose lateness is known so well is read at once, and has no column
PRESENT_NODES = 2.0  # intensities below this many first nodes are taken as absent
LINE_LEVEL = 8.0  # bins whose noise level is beyond this are lines
MOST_LINES = 4  # lines followed, the strongest: each costs two states a channel
# reading.py
FAR_SD = 3.5  # sds from the point that chance alone does not reach in some hundred windows
FAR_CURVATURE = 0.1  # share of the sd that the neglected second-order term of a row may be
FAR_SHARPEST = 0.25  # of the parameter: a window of larger sd says too little to move the point
FARTHEST_SD = 5.0  # the same where better windows placed the point: what chance does in a day moves nothing
POORER = 2.0  # times the sd of the sharpest windows that makes a window poorer than what placed the point
EVEN = 0.1  # skewness of an interval, in sds, that is not kept
FLAT = 1e-6  # prior precision of a parameter in units of its size: within a thousand times itself
# record.py
SPARE = 8192  # samples beyond those kept that may wait before the oldest are let go
PLACES = 8  # samples of a window that are looked at before all of them are
# schedule.py
EAGER = (6, 16, 32)  # windows learnt from in a row at first: at least, most of short ones, most
EAGER_SAMPLES = 12_000  # samples in them at most: long windows say more each
EAGER_A_SECOND = 64.0  # of them a second of a window at most: thirty rigs that begin together are in time
GROWTH = 2.0  # ratio of the stretches between windows learnt from afterwards
SELDOM, SELDOM_SAMPLES = 256, 256_000  # windows between two learnt from, or samples where they are short
LATEST = 5  # doublings of the time between tries at windows that cannot be solved: eight windows, at the most
FOLLOWED = 8  # windows learnt from in a row where the noise changed: of slow forces each says little
TRIES = 8  # tries a window length to solve windows that are broken
AGAIN = (
    3  # windows in which parameters that change twice, or rows that stay broken, are rather pushed by forces
)
PATIENCE = 2.0
"""Times the share of what there is to spend that a try took, of the time that a change has lasted, until the
next: a spring that gives way within one and a half windows is found while something is left."""
LASTS = 1.5  # windows that one change is in the way at the most; what lasts longer may be forces that began
BURST = 720  # evaluations that may follow one another: a step and its aftermath
FIRST = 192  # evaluations besides, once: the first windows, which take six each where the model fits
SWITCHES = 80  # evaluations for asking whether constants switched: it takes 40 to 60 where they did
LONGEST = 200  # evaluations after which what was begun goes no further down: solves that fit take 3 to 10
SAMPLES_AN_EVALUATION = 512  # samples that pay for one evaluation: bounds the cost where nothing fits
SECONDS_AN_EVALUATION = 0.512
"""Seconds of samples that pay for one, where these are fewer: below 1 kHz a processor has the time (3 ms in
half a second are a half per cent of it), and a part that wears is followed with a window a cycle."""
EVALUATIONS_A_WINDOW = 8  # at most that a window pays for: where windows are long each costs more
# sliding.py
RETRY = 4  # tries a window length to find a first window that fits
MOST_LOST = 0.1  # share of a window's samples that may lack readings: with more it is not worth its cost
