"""Balanced coordinates for everything that an initial state does to e and ψ.

    G(k) = [Γ, D_1 .. D_c](k),   Γ = W C̃ Φ̃ᵏ (physical, coloured and line states),   D_i: r -> ψ_i

are n_g + c n sequences that span only a few: G(k) = U(k) Y with U orthonormal over the longest window, from
its triangular factor (QR by doubling, not the Gramian) and an SVD; U(k + m) = U(k) Π_m (balancing: Moore,
IEEE Trans. Automatic Control 26 (1981) 17; the square-root form: Tombs & Postlethwaite, Int. J. Control 46
(1987) 1319).
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.riccati import Predictor
from agent.numerics.model.singular import leading
from agent.numerics.window.filtering.filters import System, whitening
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import Realisation
from agent.numerics.window.filtering.transition import Transition
from agent.numerics.window.tuning import NEGLIGIBLE
from agent.types import FloatArray


class HopFactors:
    """Triangular factors of what moves by `step` each hop, over 1, 2, 4 .. hops, each worked out once.

    Args:
        one: (r, r) factor over one hop.
        step: Π of a hop.
    """

    def __init__(self, one: FloatArray, step: FloatArray) -> None:
        self._levels = [(one, step)]

    def over(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return the triangular factor over `count` hops, and Π over them.

        Raises:
            ValueError: count is 0.
        """
        total: FloatArray | None = None
        over = np.eye(len(self._levels[0][1]))
        for level in range(count.bit_length()):
            one, step = self._level(level)
            if count >> level & 1:
                total = one if total is None else _triangle(np.vstack([total, one @ over]))
                over = step @ over
        if total is None:
            raise ValueError("a window of no hops has no factor")
        return total, over

    def _level(self, level: int) -> tuple[FloatArray, FloatArray]:
        while level >= len(self._levels):
            one, step = self._levels[-1]
            self._levels.append((_triangle(np.vstack([one, one @ step])), step @ step))
        return self._levels[level]


@dataclass(frozen=True, slots=True)
class Basis:
    """Balanced coordinates of the free responses.

    Attributes:
        U: (H p, r) over a hop.
        steps: Π of a head, of a rest and of a hop, (r, r) each.
        gamma: (r, n_g) coordinates of Γ.
        drift: (c, r, n) coordinates of D_i.
        head, hops: triangular factors of U over a head, and over whole hops.
        plan: hop and window.
    """

    U: FloatArray
    steps: tuple[FloatArray, FloatArray, FloatArray]
    gamma: FloatArray
    drift: FloatArray
    head: FloatArray
    hops: HopFactors
    plan: HopPlan

    def factor(self, fulls: int) -> FloatArray:
        """Return the triangular factor of U over so many whole hops and a head, by doubling."""
        if not fulls:
            return self.head
        whole, over = self.hops.over(fulls)
        return _triangle(np.vstack([whole, self.head @ over]))

    def over(self, fulls: int) -> FloatArray:
        """Return Π of so many whole hops."""
        return np.linalg.matrix_power(self.steps[2], fulls)


def balanced_basis(
    system: System, real: Realisation, predictor: Predictor, plan: HopPlan, longest: int
) -> Basis:
    """Return the balanced coordinates for windows up to `longest` whole hops and a head."""
    G, sample = _free_responses(system, real, predictor, plan.hop)
    over = {samples: sample.power(samples).of_responses() for samples in (plan.head, plan.rest, plan.hop)}
    factor, _ = HopFactors(_triangle(G), over[plan.hop]).over(longest + 1)
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0] = 1.0
    s, Vt = leading(factor / scale, NEGLIGIBLE)
    r = len(s)
    to_balanced = s[:, None] * Vt * scale  # Y
    from_balanced = (Vt.T / s) / scale[:, None]
    steps = (plan.head, plan.rest, plan.hop)
    head, rest, hop = (to_balanced @ over[samples] @ from_balanced for samples in steps)
    size = system.size
    n_g = len(real.A)
    drift = to_balanced[:, n_g:].reshape(r, size.c, size.n).transpose(1, 0, 2)
    U = np.ascontiguousarray(G @ from_balanced)
    of_head = _triangle(U[: plan.head * size.p])
    hops = HopFactors(_triangle(U), hop)
    return Basis(U, (head, rest, hop), to_balanced[:, :n_g], drift, of_head, hops, plan)


def _free_responses(
    system: System, real: Realisation, predictor: Predictor, hop: int
) -> tuple[FloatArray, Transition]:
    """Return G over a hop, (H p, n_g + c n), and what carries it on by a sample; n_g counts lines too."""
    a, n, p = system.size.a, system.size.n, system.size.p
    n_g = len(real.A)
    gain = np.zeros((n_g, p))
    gain[:a] = predictor.K
    step = system.step
    # what r leaves in t_i is Γ's; a line drives no filter
    from_mean = np.pad(step.from_mean, ((0, 0), (0, n_g - a), (0, 0)))
    sample = Transition(real.A - gain @ real.C, step.mean, from_mean)
    drift = system.H[1:, :, :n]
    Gamma, D = sample.responses(whitening(predictor) @ real.C, drift, hop)
    return np.concatenate([Gamma, D.reshape(hop, p, -1)], axis=2).reshape(hop * p, -1), sample


def _triangle(matrix: FloatArray) -> FloatArray:
    """Return R of matrix = Q R."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))
