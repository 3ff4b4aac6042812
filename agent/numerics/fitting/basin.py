"""A fit from wherever it begins: through the wide basin of an observer that corrects, or straight to the maximum.

An observer that forgets within a window makes a wrong model look nearly right, which is why a fit from far away goes
through it. Where few outputs show many states it makes other wrong models look better than the right one, and a fit
that begins near the truth is led away from it. What leaves the readings unexplained is therefore fitted straight too.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import Fit, Problem, fit_window
from agent.numerics.model.observer import Gain
from agent.numerics.model.statespace import Discrete

FloatArray = NDArray[np.float64]
EXPLAINED = 2.0
"""A converged fit that leaves no more residual variance than this is at no wrong maximum."""


def fit_widely(
    problem: Problem, theta: FloatArray, x0: FloatArray, stages: Sequence[Callable[[Discrete], Gain]],
    max_steps: int = 12, tolerance: float = 1e-5,
) -> Fit:  # fmt: skip
    """Fit a window from (theta, x0) through all stages; where that fails straight by the last one: the better fit.

    Raises ValueError where both ways leave the numbers.
    """
    ways: list[Sequence[Callable[[Discrete], Gain]]] = [stages]
    at = problem.sample(theta)
    if not np.array_equal(stages[0](at).L, stages[-1](at).L):
        ways.append(stages[-1:])
    fits: list[Fit] = []
    for way in ways:
        try:
            fits.append(fit_window(problem, theta, x0, way, max_steps, tolerance))
        except ValueError:
            continue  # the other way may yet end at a maximum
        if explains(fits[-1]):
            return fits[-1]
    if not fits:
        raise ValueError("no fit stays among the numbers")
    return min(fits, key=lambda fit: (not fit.converged, _left(fit)))


def explains(fit: Fit) -> bool:
    """Tell whether a fit converged and leaves little more than noise."""
    return fit.converged and _left(fit) <= EXPLAINED


def _left(fit: Fit) -> float:
    """Residual variance in units of the noise; infinite where it is no number."""
    left = float(np.mean(fit.residual**2)) if fit.residual.size else np.inf
    return left if np.isfinite(left) else np.inf
