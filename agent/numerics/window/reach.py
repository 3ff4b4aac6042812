"""How far from theta_r one linear step is right: an error that turns a mode by much within a window bends its answer.

Innovations answer a parameter through the poles of the observer: over a window a small change turns and damps each mode
by an angle in proportion to it, and what the step leaves out is half that angle times what it takes in (the second term
of the series). A longer window turns further and knows the parameters better: what it leaves out grows against its sd
by the length to the power of 5/2 until the modes have forgotten.
"""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.model.statespace import StateSpace

FloatArray = NDArray[np.float64]
STRAIN = 0.5
"""Standard deviations that a linear step may leave out: intervals of 95 % then still hold the truth in 92 %."""


def turns(model: StateSpace, L: FloatArray, window: int) -> FloatArray:
    """Return the angle (q,) in radians by which a unit of each parameter turns or damps the fastest-moving mode.

    Args:
        model: sampled.
        L: (n, p) the observer's gain.
        window: samples over which angles add up, as far as the mode remembers them.
    """
    poles, modes = np.linalg.eig(model.A - L @ model.C)
    left = np.linalg.pinv(modes)
    moved = np.einsum("jn,qnm,mj->qj", left, model.dA - L @ model.dC, modes)
    size = np.maximum(np.abs(poles), 1e-300)
    fading = -np.log(np.minimum(size, 1.0))
    remembered = np.where(window * fading > 1e-6, -np.expm1(-window * fading) / np.maximum(fading, 1e-300), window)
    return np.asarray(np.max(np.abs(moved) / size * remembered, axis=1))


def strain(turn: FloatArray, delta: FloatArray, explained: FloatArray) -> FloatArray:
    """Return how much (N,) linear steps delta (N, q) leave out at most, in standard deviations of what they find.

    turn (q,) as of `turns`; explained (N,) the chi-square of delta. NaN where nothing is known.
    """
    return np.asarray(0.5 * np.sqrt((delta**2 @ turn**2) * np.maximum(explained, 0.0)))
