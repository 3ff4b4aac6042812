"""Tuned numbers of evaluation: name, value, unit, and why."""

# compare/methods, rivals, trial
WALKS = (1e-6, 1e-5, 1e-4, 1e-3, 1e-2)
PUSHES = (1e-9, 1e-5, 1e-3, 1e-2)
MEMORIES = (0.98, 0.99, 0.996, 0.998, 0.9995)
SPEEDS = (2.0, 6.0)
RATES = (1e-4, 1e-3, 1e-2, 1e-1)  # choices: walk a sample, force, forgetting, poles, rate of adapting
POLES_APART = 0.05  # share by which observer poles differ: one output cannot place equal ones
SLOWEST_SHARE = 0.1  # of the fastest pole: what a slower one counts as where poles are placed
METHOD_BLOCK, PARTS = 65_536, 12
"""Samples that a method of the product is given at once, as in a replay; and into how many parts at least.
Its cost is that of the scored part: the first fit and the search for unknown forces happen once in an agent's
life."""
SETTLING_SAMPLES = 2000  # samples at most whose motion says how large the states of a rig are
MOST_COMPARED = 100_000  # samples of a recording compared over: the joint UKF takes 0.25 ms for each
TUNED_PARTS = 3  # the first of so many parts of a recording is tuned on; the others are scored
MOST_TUNED = 10_000  # samples that are tuned on: a grid of choices runs over them
LEAST_WINDOWS = 3  # windows that the longest piece of a recording must hold
MOST_SCORED = 40  # windows that are predicted, spread over the scored part
FASTER_POLE = 1e3  # times nominal's fastest pole beyond which a pole is no machine's and predicts nothing

# demo/demo
STALL_S = 20.0  # s without a new row after which the demonstration has stalled
GRACE_S = 20.0  # s that a process may take to end

# explain/explain
NEAR_SD = 1e-9  # of the sd: how far the same verdict may be off, however samples were cut into blocks

# paper/figures, methods, paper
DRAWN_HOP = 25  # samples from one drawn estimate to the next
ROUNDING_M = 1e-9  # sensor sd that noise-free displacements of a centimetre are given at the least, m
WINDOW, PASSES = 250, 16  # the paper's window; passes until the fixed point shows in all its digits

# score/match, measures, play
SEARCHED_ROWS = 8  # rows that must agree for a stretch to be found again
ALARM_GRACE_S = 0.5  # how long after an excursion's last window an alarm may still be its own
READ_S = 0.2  # s of played time that a reader waits for samples at most
STEP_S = 0.05  # s of played time from one turn of the readers to the next
LINGER_S = 0.5  # played on after the last sample, so that what a device still holds is read
