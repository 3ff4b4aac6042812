"""What a window says of the parameters once its initial state is eliminated: exact generalised least squares.

With a steady-state predictor z(k0) = ẑ(k0) + ξ + ζ, where ζ ~ N(0, P) makes the innovations exactly white,
and

    e = Γ ξ + Ψ δ + white,   ξ flat for physical states and lines
    ξ_f ~ N(−ẑ_f(k0), V),    V = prior − P_ff

for coloured noise states f. This is the likelihood of the readings in the window alone, whatever came before.
With V = L L' and ξ_f = −ẑ_f + L s, s ~ N(0, I), everything becomes least squares of [e + Γ_f ẑ_f, Ψ − Γ_f
t_f(k0)] on B = [Γ_x, Γ_l, Γ_f L] with the rows J = diag(0, 0, I) below. The sensitivities are those of the
mean that starts at the window's own best state (the exact point of variable projection: Golub & Pereyra, SIAM
J. Numer. Anal. 10 (1973) 413):

    x0* = x̂ + ξ_x + P_xf Γ_f' residual,    ψᵢ <- ψᵢ + D_i (x0* − r(k0))

What is left after projection is the restricted likelihood (Harville, Biometrika 61 (1974) 383).
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.riccati import Predictor
from agent.numerics.model.singular import singular
from agent.numerics.window.filtering.basis import Basis
from agent.numerics.window.filtering.filters import Sizes
from agent.numerics.window.filtering.noise import Realisation
from agent.numerics.window.filtering.products import row_products
from agent.numerics.window.filtering.summary import Summary
from agent.numerics.window.tuning import UNSEEN
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Starts:
    """The filters' states at N windows' first samples.

    Attributes:
        predicted: (N, a) the predictor's, physical then coloured.
        mean: (N, n) the mean's.
        tangents: (N, c, a) the sensitivities'.
    """

    predicted: FloatArray
    mean: FloatArray
    tangents: FloatArray

    @classmethod
    def of(cls, z: FloatArray, size: Sizes) -> "Starts":
        """Cut filter states (N, nz) into their parts."""
        a, n = size.a, size.n
        return cls(z[:, n : n + a], z[:, :n], z[:, n + a :].reshape(len(z), size.c, a))

    def part(self, which: slice) -> "Starts":
        """Return some of the windows'."""
        return Starts(self.predicted[which], self.mean[which], self.tangents[which])


@dataclass(frozen=True, slots=True)
class Normal:
    """Normal equations of N windows in d = (δ, η), parameters of interest and constants of the rig.

    With a prior N(m, P) on η the posterior has covariance (H + diag(0, P⁻¹))⁻¹ and mean covariance (g + (0,
    P⁻¹ m)).

    Attributes:
        equations: (N, c, 1+c) g and H side by side.
        rss: (N,) squared residual at d = 0.
        log_det: log|covariance of the window's readings| + log|information on the initial state|.
        x0: (N, n) best (shifted) physical state at the window's first sample.
    """

    equations: FloatArray
    rss: FloatArray
    log_det: float
    x0: FloatArray

    @property
    def H(self) -> FloatArray:  # noqa: N802 - as the books call it
        """(N, c, c), a view."""
        return self.equations[:, :, 1:]

    @property
    def g(self) -> FloatArray:
        """(N, c), a view."""
        return self.equations[:, :, 0]


@dataclass(frozen=True, slots=True)
class Solved:
    """Windows solved, and what the scan for a jump takes over.

    Attributes:
        normal: normal equations.
        moved: (N, 1+c, r+k) what was added to [e ψ], in balanced coordinates, and −½ of the components of [e
            ψ] along the initial states.
    """

    normal: Normal
    moved: FloatArray

    def part(self, which: slice) -> "Solved":
        """Return some of the windows."""
        n = self.normal
        return Solved(Normal(n.equations[which], n.rss[which], n.log_det, n.x0[which]), self.moved[which])


class WindowSolver:
    """Constants of windows of so many whole hops and a head."""

    def __init__(self, basis: Basis, real: Realisation, predictor: Predictor, fulls: int) -> None:
        n, a = real.n, real.filtered
        self.n = n
        self.a = a
        self.samples = basis.plan.samples(fulls)
        self._gamma_f = basis.gamma[:, n:a]
        self._drift = np.ascontiguousarray(basis.drift.transpose(2, 0, 1).reshape(n, -1))
        loading = _root(np.diag(real.prior_var[n:a]) - predictor.P[n:a, n:a])
        flat = np.hstack([basis.gamma[:, :n], basis.gamma[:, a:]])
        span = np.hstack([flat, self._gamma_f @ loading])
        penalty = np.hstack([np.zeros((a - n, flat.shape[1])), np.eye(a - n)])
        factor = basis.factor(fulls)
        root, orthonormal, log_det = _orthonormal(np.vstack([factor @ span, penalty]))
        self.log_det = float(log_det + self.samples * np.linalg.slogdet(predictor.S)[1])
        self.directions = (
            span @ root
        )  # (r, k): an orthonormal basis of the initial states' reach is U times it
        UU = factor.T @ factor
        self.reach = self.directions.T @ UU  # (k, r)
        padded = np.vstack([factor, np.zeros((a - n, factor.shape[1]))])
        outside = padded - orthonormal @ (orthonormal.T @ padded)
        self._beside = np.vstack([0.5 * outside.T @ outside, 2 * self.reach])
        self._state = root[:n].T  # components -> ξ_x
        self._predictor_share = self._gamma_f @ predictor.P[:n, n:a].T  # (r, n): U' residual -> ζ_x
        self._seen = (UU, self.reach)

    def solve(self, summary: Summary, starts: Starts) -> Solved:
        """Eliminate the initial states of N windows."""
        count, width, r = summary.moment.shape
        moved = np.zeros((count, width, r + self.directions.shape[1]))
        shift = moved[:, :, :r]
        components = row_products(summary.moment, self.directions)  # (N, 1+c, k)
        noisy = self.a > self.n
        if noisy:
            shift[:, 0] = row_products(starts.predicted[:, self.n :], self._gamma_f.T)
            shift[:, 1:] = -starts.tangents[:, :, self.n :] @ self._gamma_f.T
        first = components[:, 0] + (row_products(shift[:, 0], self.reach.T) if noisy else 0.0)
        x0 = starts.predicted[:, : self.n] + row_products(first, self._state)
        if noisy:
            UU, reach = self._seen
            residual = summary.moment[:, 0] + row_products(shift[:, 0], UU) - row_products(first, reach)
            x0 = x0 + row_products(residual, self._predictor_share)
        shift[:, 1:] += row_products(x0 - starts.mean, self._drift).reshape(count, width - 1, r)
        np.multiply(-0.5, components, out=moved[:, :, r:])
        # [e* ψ*]'(1 − projection)[e* ψ*] = gram + X + X', X one product
        beside = summary.moment + row_products(moved, self._beside)
        half = moved @ np.concatenate([beside, components], axis=2).transpose(0, 2, 1)
        gram = summary.gram + half + half.transpose(0, 2, 1)
        return Solved(Normal(gram[:, 1:], np.maximum(gram[:, 0, 0], 0.0), self.log_det, x0), moved)


def inverse(M: FloatArray) -> FloatArray:
    """Return the inverse of positive M (..., k, k): what nothing shows has a huge sd, all else its own."""
    d = 1.0 / np.sqrt(np.maximum(M.diagonal(axis1=-2, axis2=-1), 1e-300))
    scale = d[..., :, None] * d[..., None, :]
    return np.asarray(np.linalg.inv(M * scale + UNSEEN * np.eye(M.shape[-1])) * scale)


def _orthonormal(span: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return root, span @ root (orthonormal columns) and log|span' span|, unseen directions left out."""
    scale = np.linalg.norm(span, axis=0)
    scale[scale == 0] = 1.0
    left, s, Vt = singular(span / scale)
    k = int((s > UNSEEN * s[0]).sum())
    log_det = 2 * float(np.log(s[:k]).sum() + np.log(scale).sum())
    return (Vt[:k].T / s[:k]) / scale[:, None], left[:, :k], log_det


def _root(covariance: FloatArray) -> FloatArray:
    """Return L with L L' = covariance, which may be singular."""
    values, vectors = np.linalg.eigh((covariance + covariance.T) / 2)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
