"""How much may be computed beside the rows, counted in evaluations of the model on a window.

One evaluation is one linearisation or one trial of a step; learning the noise counts as two. Solves that converge take
three to ten of them, those that do not up to a hundred and fifty: what is bounded is the work and not the number of
tries.
"""

from agent.numerics.fitting.work import Budget

BURST = 480
"""Evaluations that may follow one another: the first windows, or a step and its aftermath."""
SAMPLES_AN_EVALUATION = 512
"""Samples that pay for one evaluation: what bounds the cost of a rig that nothing fits, its first windows apart."""
EVALUATIONS_A_WINDOW = 8
"""Evaluations that a window pays for at the most: where windows are long each evaluation costs more."""


def samples_an_evaluation(window: int) -> float:
    """Return the samples that pay for one evaluation of a window of so many samples."""
    return max(window / EVALUATIONS_A_WINDOW, SAMPLES_AN_EVALUATION)


def budget_of(window: int) -> Budget:
    """Return the budget of an estimator whose windows have so many samples."""
    return Budget(BURST * samples_an_evaluation(window), 1.0)
