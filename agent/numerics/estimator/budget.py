"""How much may be computed beside the rows, counted in evaluations of the model on a window.

One evaluation is one linearisation or one trial of a step; learning the noise counts as two. Solves that
converge take three to ten of them, those that do not up to a hundred and fifty: what is bounded is the work
and not the number of tries. N samples pay for BURST + FIRST + N / `samples_an_evaluation` evaluations, and
what was begun last for at most LONGEST beyond that.
"""

from agent.numerics.fitting.work import Budget

BURST = 480
"""Evaluations that may follow one another: a step and its aftermath."""
FIRST = 192
"""Evaluations besides, once: the first 32 windows, which take six each where the model fits."""
LONGEST = 200
"""Evaluations after which what was begun goes no further down: a solve takes 3 to 10 where the model fits."""
SAMPLES_AN_EVALUATION = 512
"""Samples that pay for one evaluation: what bounds the cost of a rig that nothing fits."""
SECONDS_AN_EVALUATION = 0.512
"""Seconds of samples that pay for one, where these are fewer: below 1 kHz a processor has the time (3 ms in
half a second are a half per cent of it), and a part that wears is followed with a window a cycle."""
EVALUATIONS_A_WINDOW = 8
"""Evaluations that a window pays for at the most: where windows are long each evaluation costs more."""


def samples_an_evaluation(window: int, period_s: float) -> float:
    """Return the samples, period_s apart, that pay for one evaluation of a window of so many samples."""
    return max(window / EVALUATIONS_A_WINDOW, min(SAMPLES_AN_EVALUATION, SECONDS_AN_EVALUATION / period_s))


def budget_of(window: int, period_s: float) -> Budget:
    """Return the budget of an estimator whose windows have so many samples, period_s apart."""
    each = samples_an_evaluation(window, period_s)
    return Budget(BURST * each, 1.0, once=FIRST * each)
