"""Generalised likelihood ratio of one jump of the parameters at a boundary inside a window.

A jump of δᵢ at b has the column Jᵢ = ψᵢ restarted with tᵢ(b) = 0, zero before b. On the right part, whose
summary is the shorter window that ends at the same row, Jᵢ = ψᵢ + U (D_i (r*(b) − r(b)) − Γ tᵢ(b)) in
balanced coordinates, so the window's and the right part's summaries give X'J and J'J for X = [e* ψ*], and

    2 log GLR = g_J' H_J⁻¹ g_J,   g_J = J'(e* − ψ* d̂),   H_J = J'J − J'ψ* cov ψ*'J

with Γ projected out everywhere.
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.basis import Basis
from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.filtering.summary import Summary
from agent.numerics.window.solve import Solved, Starts, WindowSolver
from agent.numerics.window.tuning import BOUNDARIES, GROUP, SCANS, SINGULAR
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Jumps:
    """Columns of a jump of the q parameters of interest at each of b boundaries of N windows.

    Attributes:
        index: (N,) newest sample of each window.
        cross: (N, b, 1+c, q) [e* ψ*]'J.
        own: (N, b, q, q) J'J.
        samples: (b,) length of the part after each boundary.
    """

    index: IntArray
    cross: FloatArray
    own: FloatArray
    samples: tuple[int, ...]

    def part(self, which: slice) -> "Jumps":
        """Return some of the windows."""
        return Jumps(self.index[which], self.cross[which], self.own[which], self.samples)

    def glr(self, d: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return 2 log GLR (N, b) against estimates d (N, c) with covariance (N, c, c), prior included.

        A constant that is taken as known has rows and columns of zeros in the covariance.
        """
        shown = self.cross[:, :, 1:]
        score = self.cross[:, :, 0] - np.einsum("nc,nbcq->nbq", d, shown)
        information = self.own - shown.transpose(0, 1, 3, 2) @ (covariance[:, None] @ shown)
        left, whole = np.einsum("nbii->nbi", information), np.einsum("nbii->nbi", self.own)
        seen = left > np.maximum(
            SINGULAR * whole, 1e-300
        )  # the rest is rounding: of such a jump nothing is known
        unit = np.where(seen, 1 / np.sqrt(np.where(seen, left, 1.0)), 0.0)
        scaled = information * unit[..., :, None] * unit[..., None, :] + SINGULAR * np.eye(score.shape[-1])
        score = score * unit
        return np.asarray(np.einsum("nbi,nbi->nb", score, np.linalg.solve(scaled, score[..., None])[..., 0]))


def boundaries(fulls: int) -> tuple[int, ...]:
    """Return whole hops in the part after each boundary, longest first; fewer where the window is short."""
    rights = {fulls - max(1, int(share * fulls + 0.5)) for share in BOUNDARIES} if fulls else set()
    return tuple(sorted(rights, reverse=True))


def scanned_rows(fulls: int) -> int:
    """Return of how many rows one is scanned, at most a group of hops: they move a window by a fifth at most.

    Boundaries are a quarter of a window apart, so that wherever it is a jump passes near one of them several
    times. Where each of the whole hops begins with one, two of its places are enough.
    """
    times = 0.5 * SCANS if len(boundaries(fulls)) == fulls else SCANS
    return max(every for every in (1, 2, 4, GROUP) if every == 1 or times * every <= fulls + 1)


@dataclass(frozen=True, slots=True)
class LostRight:
    """What l lost readings of one window do, and what they do on the right of a boundary.

    Attributes:
        psi, U: (l, c), (l, r) h'ψ and h'U on the right, in coordinates of the boundary.
        components: (l, k) along the window's initial states.
        cross: (l, 1+c) h'[e* ψ*], Γ projected out, prior in e.
        covariance: (l, l) of the readings, all else given.
    """

    psi: FloatArray
    U: FloatArray
    components: FloatArray
    cross: FloatArray
    covariance: FloatArray


class JumpScan:
    """Constants of the columns of a jump `right` whole hops and a head before a window's end."""

    def __init__(
        self, basis: Basis, solver: WindowSolver, model: StateSpace, fulls: int, right: int, q: int
    ) -> None:
        before = fulls - right
        self.q = q
        factor = basis.factor(right)
        self.right = right
        self.square = factor.T @ factor
        n = basis.drift.shape[2]
        self._drift = np.linalg.matrix_power(model.A, before * basis.plan.hop).T @ (
            basis.drift[:q].transpose(2, 0, 1).reshape(n, -1)
        )
        self._gamma = basis.gamma[:, : solver.a].T.copy()
        over = basis.over(before)  # coordinates at the window's start -> at the boundary
        along = (
            over @ solver.directions
        )  # what is seen on the right -> components along the window's initial states
        outside = over.T - solver.reach.T @ along.T
        self._along = along
        self._moved = np.vstack([outside, 2 * along.T])

    def columns(
        self, solved: Solved, right: Summary, starts: Starts, at: Starts, lost: LostRight | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return cross (N, 1+c, q) and own (N, q, q) for N windows; `at` holds the filters at the boundary.

        lost: readings of the (one) window that are unknown; `right` is as filled by what they were found to
        be.
        """
        q = self.q
        count = len(right)
        moved = row_products(solved.normal.x0 - starts.mean, self._drift).reshape(count, q, -1)
        j = moved - row_products(at.tangents[:, :q], self._gamma)  # (N, q, r)
        alone = right.moment[:, 1 : 1 + q]
        seen = alone + row_products(j, self.square)  # U'J
        along = row_products(seen, self._along)  # (N, q, k)
        # X'J = X'ψ + [U'X; (1 − projection) of what was added]'[j; U'J],
        # J'J = ψ'ψ + half + half', half = ½ (U'ψ)'j + ½ j'U'J − ½ along'along: all in one product
        width, r = right.moment.shape[1:]
        left = np.zeros((count, width + q, 2 * r + along.shape[2]))
        left[:, :width, :r] = right.moment
        left[:, :width, r : 2 * r] = row_products(solved.moved, self._moved)
        left[:, width:, :r], left[:, width:, r : 2 * r] = 0.5 * alone, 0.5 * j
        left[:, width:, 2 * r :] = -0.5 * along
        both = left @ np.concatenate([j, seen, along], axis=2).transpose(0, 2, 1)
        gram, half = right.gram[:, :, 1 : 1 + q], both[:, width:]
        cross, own = gram + both[:, :width], gram[:, 1 : 1 + q] + half + half.transpose(0, 2, 1)
        if lost is None:
            return cross, own
        shown = (
            lost.psi[:, :q] + lost.U @ j[0].T - lost.components @ along[0].T
        )  # (l, q) h'J, Γ projected out
        weighed = lost.covariance @ shown
        return cross - lost.cross.T @ weighed, own - shown.T @ weighed
