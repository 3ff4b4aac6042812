"""Balanced coordinates for everything that an initial state does to e and ψ.

    G(k) = [Γ, D_1 .. D_c](k),   Γ = W C̃ Φ̃ᵏ (physical, coloured and line states),   D_i: r -> ψ_i

are n_g + c n sequences that span only a few: G(k) = U(k) Y with U orthonormal over the longest window, from
its triangular factor (QR by doubling, not the Gramian) and an SVD; U(k + m) = U(k) Π_m (balancing: Moore,
IEEE Trans. Automatic Control 26 (1981) 17; the square-root form: Tombs & Postlethwaite, Int. J. Control 46
(1987) 1319).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from agent.numerics.model.riccati import Predictor
from agent.numerics.model.singular import leading
from agent.numerics.window.filtering.filters import System, whitening
from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import Realisation
from agent.numerics.window.tuning import NEGLIGIBLE
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Basis:
    """Balanced coordinates of the free responses.

    Attributes:
        U: (H p, r) over a hop.
        steps: Π of a head, of a rest and of a hop, (r, r) each.
        gamma: (r, n_g) coordinates of Γ.
        drift: (c, r, n) coordinates of D_i.
        plan: hop and window.
    """

    U: FloatArray
    steps: tuple[FloatArray, FloatArray, FloatArray]
    gamma: FloatArray
    drift: FloatArray
    plan: HopPlan

    def factor(self, fulls: int) -> FloatArray:
        """Return the triangular factor of U over so many whole hops and a head, by doubling."""
        p = len(self.U) // self.plan.hop
        head = _triangle(self.U[: self.plan.head * p])
        if not fulls:
            return head
        whole, over = _over_hops(_triangle(self.U), self.steps[2], fulls)
        return _triangle(np.vstack([whole, head @ over]))

    def over(self, fulls: int) -> FloatArray:
        """Return Π of so many whole hops."""
        return np.linalg.matrix_power(self.steps[2], fulls)


def balanced_basis(
    system: System, real: Realisation, predictor: Predictor, plan: HopPlan, longest: int
) -> Basis:
    """Return the balanced coordinates for windows up to `longest` whole hops and a head."""
    G, over = _free_responses(system, real, predictor, plan.hop)
    factor, _ = _over_hops(_triangle(G), np.linalg.matrix_power(over, plan.hop), longest + 1)
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
    return Basis(
        np.ascontiguousarray(G @ from_balanced), (head, rest, hop), to_balanced[:, :n_g], drift, plan
    )


def _free_responses(
    system: System, real: Realisation, predictor: Predictor, hop: int
) -> tuple[FloatArray, FloatArray]:
    """Return G over a hop, (H p, n_g + c n), and what carries it on by one sample."""
    size = system.size
    n_g = len(real.A)
    a, n, c, p = size.a, size.n, size.c, size.p
    gain = np.zeros((n_g, p))
    gain[:a] = predictor.K
    carry = block_diag(real.A - gain @ real.C, system.F[a:, a:])
    # columns: initial states of Γ, then of r once for each D_i; rows of `carry` also hold t_i
    seen = np.zeros((1 + c, p, len(carry)))
    seen[0, :, :n_g] = whitening(predictor) @ real.C
    seen[1:, :, n_g:] = system.H[1:, :, a:]
    over = _carrying(carry, n_g, n, a, c)
    state = np.eye(len(carry))[:, : n_g + n]
    G = np.empty((hop, p, n_g + c * n))
    for k in range(hop):
        out = seen.reshape(-1, len(carry)) @ state
        out = out.reshape(1 + c, p, n_g + n)
        G[k, :, :n_g] = out[0, :, :n_g]
        G[k, :, n_g:] = out[1:, :, n_g:].transpose(1, 0, 2).reshape(p, c * n)
        state = carry @ state
    return G.reshape(hop * p, -1), over


def _carrying(carry: FloatArray, n_g: int, n: int, a: int, c: int) -> FloatArray:
    """Return P with G(k+1) = G(k) P: Γ moves by Φ̃, D_i by A and by what r leaves in t_i, which is Γ's."""
    A = carry[n_g : n_g + n, n_g : n_g + n]
    P = block_diag(carry[:n_g, :n_g], *[A] * c)
    for i in range(c):
        from_r = carry[n_g + n + i * a : n_g + n + (i + 1) * a, n_g : n_g + n]
        P[:a, n_g + i * n : n_g + (i + 1) * n] = from_r
    return P


def _over_hops(one: FloatArray, step: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the triangular factor over `count` hops from that of one, and Π over them, by doubling."""
    total: FloatArray | None = None
    over = np.eye(len(step))
    while True:
        if count & 1:
            total = one if total is None else _triangle(np.vstack([total, one @ over]))
            over = step @ over
        count >>= 1
        if not count:
            break
        one = _triangle(np.vstack([one, one @ step]))
        step = step @ step
    if total is None:
        raise ValueError("a window of no hops has no factor")
    return total, over


def _triangle(matrix: FloatArray) -> FloatArray:
    """Return R of matrix = Q R."""
    return np.asarray(np.linalg.qr(matrix, mode="r"))
