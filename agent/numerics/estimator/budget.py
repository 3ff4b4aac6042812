"""How much may be computed beside the rows, counted in evaluations of the model on a window.

One evaluation is one linearisation or one trial of a step; learning the noise counts as two. Solves that
converge take three to ten of them, those that do not up to a hundred and fifty: what is bounded is the work
and not the number of tries. N samples pay for BURST + FIRST + N / SAMPLES_AN_EVALUATION evaluations, and what
was begun last for at most LONGEST beyond that.
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
EVALUATIONS_A_WINDOW = 8
"""Evaluations that a window pays for at the most: where windows are long each evaluation costs more."""


def samples_an_evaluation(window: int) -> float:
    """Return the samples that pay for one evaluation of a window of so many samples."""
    return max(window / EVALUATIONS_A_WINDOW, SAMPLES_AN_EVALUATION)


def budget_of(window: int) -> Budget:
    """Return the budget of an estimator whose windows have so many samples."""
    each = samples_an_evaluation(window)
    return Budget(BURST * each, 1.0, once=FIRST * each)
