"""How probable it is that a deviation lies beyond a limit, given its estimate, standard deviation and dof.

With T(·; ν) the distribution function of Student's t, d the estimated deviation, σ its standard deviation:

    P(Δ > level) = T((d − level)/σ; ν),   P(Δ < −level) = T((−d − level)/σ; ν),   both sides: their sum.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

from agent.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Deviations:
    """Estimated deviations: N rows of r columns.

    Attributes:
        delta, sd: (N, r) estimate and standard deviation.
        dof: (N,) degrees of freedom of the standard deviation; inf where it is known.
        up, down: (r,) whether a column looks at the upper side, at the lower side.
    """

    delta: FloatArray
    sd: FloatArray
    dof: FloatArray
    up: BoolArray
    down: BoolArray

    def beyond(self, level: FloatArray, at: tuple[NDArray[np.intp], ...]) -> FloatArray:
        """Return the probability beyond level (r,) at the elements (rows, columns); NaN without a number."""
        rows, columns = at
        delta, sd, dof, edge = self.delta[at], self.sd[at], self.dof[rows], level[columns]
        with np.errstate(divide="ignore", invalid="ignore"):
            above, below = stdtr(dof, (delta - edge) / sd), stdtr(dof, (-delta - edge) / sd)
        probability: FloatArray = self.up[columns] * above + self.down[columns] * below
        return probability

    def exceed(self, level: FloatArray, confidence: FloatArray, among: BoolArray) -> BoolArray:
        """Return where P(beyond level) ≥ confidence (r,), in [0.5, 1), of the elements among (N, r)."""
        # Both tails together reach one half only from one sd under the level on: 2 T(−1; ν) ≤ 2 T(−1; 1) =
        # 1/2.
        maybe = np.nonzero(among & (self._margin(level) > -1.0))
        result = np.zeros(among.shape, dtype=np.bool_)
        result[maybe] = self.beyond(level, maybe) >= confidence[maybe[1]]
        return result

    def stay_within(self, level: FloatArray, confidence: FloatArray, among: BoolArray) -> BoolArray:
        """Return where P(within level) ≥ confidence (r,), in [0.5, 1), of the elements among (N, r)."""
        # A tail that begins inside the estimate already holds one half.
        maybe = np.nonzero(among & (self._margin(level) < 0.0))
        result = np.zeros(among.shape, dtype=np.bool_)
        result[maybe] = 1.0 - self.beyond(level, maybe) >= confidence[maybe[1]]
        return result

    def _margin(self, level: FloatArray) -> FloatArray:
        """By how many sd the estimate lies beyond the level, on the side that is nearer to it."""
        reach = np.maximum(np.where(self.up, self.delta, -np.inf), np.where(self.down, -self.delta, -np.inf))
        with np.errstate(divide="ignore", invalid="ignore"):
            margin: FloatArray = (reach - level) / self.sd
        return margin
