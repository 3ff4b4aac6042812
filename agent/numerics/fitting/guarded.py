"""A window that a wrong hypothesis may blow up: what is no number ends the fit instead of reaching the linear algebra.

LAPACK reports what is not finite on the standard output, where nothing but results may stand.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import Linearised, Problem
from agent.numerics.model.observer import Gain

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
GREATEST = 1e60
"""What a motion, an innovation or a sensitivity may grow to."""


@dataclass(frozen=True, slots=True)
class GuardedProblem(Problem):
    """One window to fit; `at` raises ValueError where the model is no number there, or grows beyond all bounds."""

    def at(self, theta: FloatArray, gain: Gain, x0: FloatArray) -> Linearised:
        """Linearise the window about (theta, x0)."""
        if not np.all(np.isfinite(theta)) or not np.all(np.isfinite(x0)):
            raise ValueError("the fit left the numbers")
        model = self.sample(theta).model
        matrices = (model.A, model.B, model.C, model.D, model.dA, model.dB, model.dC, model.dD, gain.L)
        if not all(np.all(np.isfinite(matrix)) for matrix in matrices):
            raise ValueError("the model is no number")
        radius = float(np.abs(np.linalg.eigvals(model.A - gain.L @ model.C)).max(initial=0.0))
        if len(self.v) * np.log10(max(radius, 1.0)) > np.log10(GREATEST) / 2:
            raise ValueError("the observer grows beyond all bounds")
        with np.errstate(all="ignore"):  # what overflows is looked at below
            # named outright: a class with slots is made twice, and super() would mean the first one
            here = Problem.at(self, theta, gain, x0)
            if not (here.cost < GREATEST**2 and np.all(np.abs(here.psi) < GREATEST)):
                raise ValueError("the window is no number")
        return here


def sized(scale: FloatArray, column: IntArray | None, v: FloatArray) -> FloatArray:
    """Return sizes (q,) of parameters; offsets, whose scale is NaN, have that of their column of v (N, p + m)."""
    rms = np.sqrt(np.mean(v**2, axis=0))
    own = rms[np.zeros(len(scale), dtype=np.int64) if column is None else np.minimum(column, len(rms) - 1)]
    return np.where(np.isfinite(scale), scale, np.where(own > 0, own, 1.0))
