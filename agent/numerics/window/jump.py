"""Generalised likelihood ratio of one jump of the parameters at a boundary inside a window.

A jump of δᵢ at b has the column Jᵢ = ψᵢ restarted with tᵢ(b) = 0, zero before b. On the right part, whose
summary is the shorter window that ends at the same row, Jᵢ = ψᵢ + U (D_i (r*(b) − r(b)) − Γ tᵢ(b)) in
balanced coordinates, so the window's and the right part's summaries give X'J and J'J for X = [e* ψ*], and

    2 log GLR = g_J' H_J⁻¹ g_J,   g_J = J'(e* − ψ* d̂),   H_J = J'J − J'ψ* cov ψ*'J

with Γ projected out everywhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.model.statespace import StateSpace
from agent.numerics.window.filtering.basis import Basis
from agent.numerics.window.filtering.products import row_products, stacked_products
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
        taken = np.concatenate([covariance, d[:, None]], axis=1)[:, None] @ shown
        score = self.cross[:, :, 0] - taken[:, :, -1]
        information = self.own - shown.swapaxes(2, 3) @ taken[:, :, :-1]
        left, whole = information.diagonal(axis1=2, axis2=3), self.own.diagonal(axis1=2, axis2=3)
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
    """Constants of the columns of jumps, each of them so many whole hops and a head before a window's end."""

    def __init__(
        self, basis: Basis, solver: WindowSolver, model: StateSpace, fulls: int, rights: Sequence[int], q: int
    ) -> None:
        self.q = q
        n = basis.drift.shape[2]
        drift = basis.drift[:q].transpose(2, 0, 1).reshape(n, -1)
        befores = [(fulls - right) * basis.plan.hop for right in rights]
        self._drift = np.hstack([np.linalg.matrix_power(model.A, before).T @ drift for before in befores])
        self._gamma = basis.gamma[:, : solver.a].T.copy()
        factors = [basis.factor(right) for right in rights]
        self._square = np.array([factor.T @ factor for factor in factors])
        # coordinates at the window's start -> at the boundary
        overs = [basis.over(fulls - right) for right in rights]
        # what is seen on the right -> components along the window's initial states
        alongs = [over @ solver.directions for over in overs]
        outsides = [over - along @ solver.reach for over, along in zip(overs, alongs, strict=True)]
        self._shown = np.concatenate([outsides, 2 * np.array(alongs)], axis=2)

    def columns(
        self, solved: Solved, rights: Sequence[Summary], starts: Starts, ats: Sequence[Starts],
        lost: Sequence[LostRight] = (),
    ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        """Return cross (b, N, 1+c, q) and own (b, N, q, q) for N windows; `ats` holds filters at boundaries.

        lost: readings of the (one) window that are unknown; `rights` are as filled by what they were found to
        be.
        """
        q = self.q
        r = len(self._gamma[0])
        moment = np.array([right.moment for right in rights])
        gram = np.array([right.gram[:, :, 1 : 1 + q] for right in rights])
        count, width = gram.shape[1:3]
        drifts = row_products(solved.normal.x0 - starts.mean, self._drift).reshape(count, -1, q, r)
        tangents = np.array([at.tangents[:, :q] for at in ats])
        j = drifts.transpose(1, 0, 2, 3) - row_products(tangents, self._gamma)
        alone = moment[:, :, 1 : 1 + q]
        seen = alone + stacked_products(j, self._square)  # U'J
        shown = stacked_products(seen, self._shown)  # (1 − projection) of it, and twice its components
        # X'J = X'ψ + [U'X; what was added to X][j; shown],
        # J'J = ψ'ψ + half + half', half = ½ (U'ψ + U'J)'j − ½ along'along: all in one product
        left = np.zeros((*gram.shape[:2], width + q, r + shown.shape[3]))
        left[:, :, :width, :r], left[:, :, :width, r:] = moment, solved.moved
        left[:, :, width:, :r] = 0.5 * (alone + seen)
        left[:, :, width:, 2 * r :] = -0.125 * shown[:, :, :, r:]
        both = left @ np.concatenate([j, shown], axis=3).swapaxes(2, 3)
        half = both[:, :, width:]
        cross, own = gram + both[:, :, :width], gram[:, :, 1 : 1 + q] + half + half.swapaxes(2, 3)
        for b, one in enumerate(lost):
            # (l, q) h'J, Γ projected out
            of_lost = one.psi[:, :q] + one.U @ j[b, 0].T - 0.5 * one.components @ shown[b, 0, :, r:].T
            weighed = one.covariance @ of_lost
            cross[b] -= one.cross.T @ weighed
            own[b] -= of_lost.T @ weighed
        return cross, own
