"""Intensities of unknown sources: the likelihood on each node of their grids, one source after the other."""

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, Ridge
from agent.numerics.inference.spectral.algebra import inverse_root
from agent.numerics.inference.spectral.covariance import Cells
from agent.numerics.inference.tuning import DROWNED, FAR_GROWTH, FREE_BINS
from agent.types import FloatArray, IntArray

PRIOR_LOG = np.zeros(tuning.NODES)
PRIOR_LOG[0] = np.log((tuning.NODES - 1) * tuning.PRIOR_ABSENT / (1 - tuning.PRIOR_ABSENT))
"""(G,) log prior of an intensity's nodes: absent, which the first node stands for, or anything."""


def scanned(
    fit: NoiseFit, order: IntArray, carried: FloatArray, nodes: FloatArray, every: bool, pred: Ridge | None
) -> "Scan":
    """Go over the intensities one by one (exact Gauss-Seidel); S⁻¹ and the Gram follow by rank one."""
    scan = Scan(fit, carried, nodes, every, pred)
    for a in order:
        scan.axis(int(a))
    if pred is not None and len(fit.there):
        scan.spread |= dict.fromkeys(fit.there.tolist(), fit.unsure(pred) / len(fit.there))
    return scan


def strongest(fit: NoiseFit, among: IntArray, nodes: FloatArray) -> FloatArray:
    """Return the intensities (a,) after those `among` them were set one by one, the most telling first.

    All of each grid is looked at: between no force and a strong one likelihood often falls.
    """
    left = among.tolist()
    fit.refresh()
    while left:
        scan = Scan(fit, np.zeros_like(nodes), nodes, every=True, pred=None)
        found = [scan.best(a) for a in left]
        fit.looks += len(left)
        most = int(np.argmax([gain for gain, _ in found]))
        gain, intensity = found[most]
        if not gain > 0:
            break
        fit.intensity[left.pop(most)] = intensity
        fit.refresh()
    return fit.intensity.copy()


class Scan:
    """One pass over intensities: on each node of a source's grid the likelihood, by a rank-one change of S.

    Attributes:
        log_weight: posterior log-weights (G,) of each source scanned;  spread: relative variance (q,) that
            each adds.
    """

    def __init__(
        self, fit: NoiseFit, carried: FloatArray, nodes: FloatArray, every: bool, pred: Ridge | None
    ) -> None:
        self.fit, self.carried, self.nodes, self.every, self.pred = fit, carried, nodes, every, pred
        self.ends = np.arange(fit.layout.ends.start, fit.layout.ends.stop)
        self.one = np.eye(fit.layout.base + 1)
        self.log_weight: dict[int, FloatArray] = {}
        self.spread: dict[int, FloatArray] = {}

    def best(self, a: int) -> tuple[float, float]:
        """Return the log likelihood of a source's most likely node above that of the first, and the node."""
        self._turn_to(a)
        logs = self._nodes(a, 0, self.nodes.shape[1], self.fit.cells.spectra[a])[0]
        most = int(np.argmax(logs))
        gain = float(logs[most] - logs[0]) if np.isfinite(logs[most]) else -np.inf  # no node has digits
        return gain, float(self.nodes[a, most])

    def axis(self, a: int) -> None:
        """Find the posterior of one intensity and move S⁻¹ and the Gram to its mean."""
        fit = self.fit
        shape = fit.cells.spectra[a]
        self._turn_to(a)
        lo, hi, logs, grams, ends = self._reach(a, shape)
        if not np.isfinite(logs).any():
            self.log_weight[a] = self.carried[
                a
            ].copy()  # no node has digits in this window: it says nothing of it
            return
        self.log_weight[a] = np.full(self.nodes.shape[1], tuning.LOWEST_LOG_WEIGHT)
        self.log_weight[a][lo:hi] = np.maximum(logs - logs.max(), tuning.LOWEST_LOG_WEIGHT)
        weight = np.exp(self.log_weight[a][lo:hi] + PRIOR_LOG[lo:hi])
        weight /= weight.sum()
        before = fit.intensity[a]
        if a not in fit.there:  # else what all sources have in common decided
            fit.intensity[a] = float(weight @ self.nodes[a, lo:hi])
        if self.pred is not None and fit.sources[a].kind == "force" and a not in fit.there:
            self.spread[a] = self._spread(a, self.nodes[a, lo:hi], weight, grams, ends)
        self._move((fit.intensity[a] ** 2 - before**2) * shape)

    def _turn_to(self, a: int) -> None:
        """Prepare rank-one changes along a source."""
        fit, kept = self.fit, self.fit.cells.kept
        h = fit.cells.D[:, :, a]
        self.Sh = (fit.Si @ h[..., None])[..., 0]
        self.hSh = (h.conj() * self.Sh).sum(axis=1).real
        row = (self.Sh[:kept].conj()[:, None, :] @ fit.X)[:, 0]
        self.rows = np.concatenate([row.real, row.imag])
        high = self.Sh[kept:]
        self.high = np.einsum("ka,kab,kb->k", high.conj(), fit.high.R, high).real

    def _reach(self, a: int, shape: FloatArray) -> tuple[int, int, FloatArray, FloatArray, FloatArray]:
        """Evaluate the nodes within reach of what was carried; further while the best stands at an end."""
        count = self.nodes.shape[1]
        alive = np.flatnonzero(self.carried[a] > tuning.LOWEST_LOG_WEIGHT + 2)
        now = int(np.searchsorted(self.nodes[a], self.fit.intensity[a]))
        lo, hi = (0, min(count, now + 6)) if self.every else (max(0, alive[0] - 1), min(count, alive[-1] + 2))
        while True:
            logs, grams, ends = self._nodes(a, lo, hi, shape)
            best = int(np.argmax(logs))
            below, above = best == 0 and lo > 0, best == len(logs) - 1 and hi < count
            if not (below or above):
                return lo, hi, logs, grams, ends
            lo, hi = max(0, lo - 4 * below), min(count, hi + 4 * above)

    def _nodes(
        self, a: int, lo: int, hi: int, shape: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Log posterior on nodes lo .. hi, their Grams, and the end effects' precisions there."""
        fit, nb = self.fit, self.fit.layout.base
        v = self.nodes[a, lo:hi]
        change = (v[:, None] ** 2 - fit.intensity[a] ** 2) * shape
        growth = 1 + change * self.hSh
        # without nearly all that is there now, the rank-one change has no digits left either
        bare = growth.min(axis=1) < 1 / FAR_GROWTH
        growth = np.maximum(growth, 1 / FAR_GROWTH)
        grams = fit.G - self._taken(change / growth)
        intensity = np.empty((len(v), len(fit.intensity)))
        intensity[:] = fit.intensity
        intensity[:, a] = v
        ends = fit.ends.precision(intensity)
        M = grams + fit.prior
        M[:, self.ends, self.ends] += ends
        # where the source would drown everything the rank-one change has no digits left
        drowned = bare | (grams[:, -1, -1] < DROWNED * fit.G[-1, -1])
        drowned |= (M.diagonal(axis1=1, axis2=2) < 0).any(axis=1)
        M[drowned] = self.one
        d = 1.0 / np.sqrt(np.maximum(M.diagonal(axis1=1, axis2=2), 1e-300))
        M *= d[:, :, None]
        M *= d[:, None, :]
        M.reshape(len(M), -1)[:, :: nb + 2] += 1e-12
        pivot = _log_pivots(M) - np.log(d)
        drowned |= ~np.isfinite(pivot).all(axis=1)
        pivot[drowned] = 0.0
        rss = np.exp(2 * pivot[:, nb])
        ends_log = np.log(ends).sum(axis=1)
        logs = -0.5 * (np.log(growth) @ fit.cells.weight + 2 * pivot[:, :nb].sum(axis=1) - ends_log + rss)
        return np.where(drowned, -np.inf, self.carried[a, lo:hi] + logs), grams, ends

    def _taken(self, w: FloatArray) -> FloatArray:
        """What the Gram loses (g, base+1, base+1) when S grows by change · d d*, or gains where S shrinks.

        w = change / (1 + change d*S⁻¹d) (g, C), of one sign in all cells.
        """
        kept, weight = self.fit.cells.kept, self.fit.cells.weight
        # a table times itself: BLAS works out one half of it, and columns of lost readings are many
        root = np.sqrt(np.abs(w[:, :kept]) * weight[:kept])
        taken = np.empty((len(w), self.rows.shape[1], self.rows.shape[1]))
        for out, each in zip(taken, np.hstack([root, root])[:, :, None], strict=True):
            half = each * self.rows
            np.matmul(half.T, half, out=out)
        taken *= np.where(w.max(axis=1) > 0, 1.0, -1.0)[:, None, None]
        taken[:, -1, -1] += w[:, kept:] @ self.high
        return taken

    def _spread(
        self, a: int, nodes: FloatArray, weight: FloatArray, grams: FloatArray, ends: FloatArray
    ) -> FloatArray:
        """Relative variance (q,) that not knowing the intensity adds to each parameter."""
        fit, nb, psi, pred = self.fit, self.fit.layout.base, self.fit.layout.psi, self.pred
        assert pred is not None  # noqa: S101 - only called where there is one
        near = int(np.argmin(np.abs(np.log(nodes) - np.log(fit.intensity[a]))))
        used = weight > 2e-3
        used[near] = True
        grams, weight = grams[used], weight[used]
        M = grams[:, :nb, :nb] + pred.R
        at = self.ends
        # put, not added and taken away: before the first window the precision is 1e300 and would leave no
        # digit
        M[:, at, at] = grams[:, at, at] + ends[used]
        H = inverse_root(M)
        own = H[:, :, psi]
        delta = ((H @ (grams[:, :nb, nb] + pred.b)[..., None]) * own).sum(axis=1)
        variance = (own**2).sum(axis=1)
        w = weight / weight.sum()
        mean = w @ delta
        total = w @ (variance + (delta - mean) ** 2)
        return np.asarray(total / variance[np.count_nonzero(used[:near])] - 1)

    def _move(self, change: FloatArray) -> None:
        fit = self.fit
        growth = 1 + change * self.hSh
        if max(growth.max(), 1 / growth.min()) > FAR_GROWTH:
            fit.refresh()
            return
        w = change / growth
        fit.G = fit.G - self._taken(w[None])[0]
        fit.Si = fit.Si - w[:, None, None] * (self.Sh[:, :, None] * self.Sh[:, None, :].conj())


def _log_pivots(M: FloatArray) -> FloatArray:
    """Return log diagonals (g, k) of Cholesky factors of M (g, k, k); NaN where one has no digits left."""
    try:
        return np.asarray(np.log(np.linalg.cholesky(M).diagonal(axis1=1, axis2=2)))
    except np.linalg.LinAlgError:
        out = np.full(M.shape[:2], np.nan)
        for i in np.flatnonzero(np.linalg.eigvalsh(M)[:, 0] > 1e-13):
            out[i] = np.log(np.diag(np.linalg.cholesky(M[i])))
        return out


def first_nodes(cells: Cells, log_sigma: FloatArray) -> FloatArray:
    """Return the grids (a, G): from a share of what equals the sensors' noise where a source is strongest."""
    gain = np.sqrt((np.abs(cells.D) ** 2 * np.exp(-2 * log_sigma)[:, None]).sum(axis=1)) * np.sqrt(
        cells.spectra.T
    )
    gain = np.where(cells.weight[:, None] > 0, gain, 0.0)
    # the lowest bins of a free mass see any force without bound
    lowest = FREE_BINS if cells.response.is_free else 0
    strongest = np.maximum(gain[lowest:].max(axis=0, initial=0.0), 1e-300)
    return np.asarray(tuning.FIRST_NODE / strongest[:, None] * tuning.NODE_RATIO ** np.arange(tuning.NODES))
