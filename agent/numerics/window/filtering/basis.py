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
from agent.numerics.window.filtering.filters import System, carried, whitening
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import Realisation
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
    G, over = _free_responses(system, real, predictor, plan.hop)
    factor, _ = HopFactors(_triangle(G), np.linalg.matrix_power(over, plan.hop)).over(longest + 1)
    scale = np.linalg.norm(factor, axis=0)
    scale[scale == 0] = 1.0
    s, Vt = leading(factor / scale, NEGLIGIBLE)
    r = len(s)
    to_balanced = s[:, None] * Vt * scale  # Y
    from_balanced = (Vt.T / s) / scale[:, None]
    steps = (plan.head, plan.rest, plan.hop)
    head, rest, hop = (to_balanced @ np.linalg.matrix_power(over, k) @ from_balanced for k in steps)
    size = system.size
    n_g = len(real.A)
    drift = to_balanced[:, n_g:].reshape(r, size.c, size.n).transpose(1, 0, 2)
    U = np.ascontiguousarray(G @ from_balanced)
    of_head = _triangle(U[: plan.head * size.p])
    hops = HopFactors(_triangle(U), hop)
    return Basis(U, (head, rest, hop), to_balanced[:, :n_g], drift, of_head, hops, plan)


def _free_responses(
    system: System, real: Realisation, predictor: Predictor, hop: int
) -> tuple[FloatArray, FloatArray]:
    """Return G over a hop, (H p, n_g + c n), and what carries it on by one sample."""
    size = system.size
    n_g = len(real.A)
    a, n, c, p = size.a, size.n, size.c, size.p
    gain = np.zeros((n_g, p))
    gain[:a] = predictor.K
    rest = system.F[a:, a:]
    carry = np.zeros((n_g + len(rest), n_g + len(rest)))
    carry[:n_g, :n_g] = real.A - gain @ real.C
    carry[n_g:, n_g:] = rest
    # columns: initial states of Γ, then of r once for each D_i; rows of `carry` also hold t_i
    seen = np.zeros((1 + c, p, len(carry)))
    seen[0, :, :n_g] = whitening(predictor) @ real.C
    seen[1:, :, n_g:] = system.H[1:, :, a:]
    over = _carrying(carry, n_g, n, a, c)
    states = carried(np.eye(len(carry))[:, : n_g + n], carry, hop)
    out = (seen.reshape(-1, len(carry)) @ states).reshape(hop, 1 + c, p, n_g + n)
    G = np.empty((hop, p, n_g + c * n))
    G[:, :, :n_g] = out[:, 0, :, :n_g]
    G[:, :, n_g:] = out[:, 1:, :, n_g:].transpose(0, 2, 1, 3).reshape(hop, p, c * n)
    return G.reshape(hop * p, -1), over


def _carrying(carry: FloatArray, n_g: int, n: int, a: int, c: int) -> FloatArray:
    """Return P with G(k+1) = G(k) P: Γ moves by Φ̃, D_i by A and by what r leaves in t_i, which is Γ's."""
    A = carry[n_g : n_g + n, n_g : n_g + n]
    P = np.zeros((n_g + c * n, n_g + c * n))
    P[:n_g, :n_g] = carry[:n_g, :n_g]
    P[n_g:, n_g:] = np.kron(np.eye(c), A)
    for i in range(c):
        from_r = carry[n_g + n + i * a : n_g + n + (i + 1) * a, n_g : n_g + n]
        P[:a, n_g + i * n : n_g + (i + 1) * n] = from_r
    return P


def _triangle(matrix: FloatArray) -> FloatArray:
    """Return R of matrix = Q R."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))
