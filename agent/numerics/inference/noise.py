"""How a rig's noise is learnt: σ by REML with a prior, a level a bin, and an intensity a source on a grid.

The likelihood is the restricted one: everything linear (initial state, parameters, constants under a wide
prior) is eliminated, so forces never explain what a mass can (Harville, J. Am. Stat. Ass. 72 (1977) 320).
"""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.spectral.algebra import inverse, log_determinant
from agent.numerics.inference.spectral.columns import Layout, Regression
from agent.numerics.inference.spectral.covariance import Cells, HighPower, inverse_of, log_determinants
from agent.numerics.inference.spectral.ends import Ends
from agent.numerics.inference.spectral.sources import Source
from agent.types import ComplexArray, FloatArray, IntArray

DROWNED = 1e-7
"""Share of the residual's power that must be left for a rank-one change of S to have digits."""

PRIOR_LOG = np.zeros(tuning.NODES)
PRIOR_LOG[0] = np.log((tuning.NODES - 1) * tuning.PRIOR_ABSENT / (1 - tuning.PRIOR_ABSENT))
"""(G,) log prior of an intensity's nodes: absent, which the first node stands for, or anything."""
FAR_GROWTH = 1e6
"""Growth of S along a source beyond which it is inverted anew: a rank-one change leaves too few digits."""
FIRST_STEPS, RESTING = 12, 0.01
"""Most scoring steps of log σ in a first window (each by 1 at most), and the step at which it rests."""
FREE_BINS = 3
"""Bins of a rig with a free mass that do not count for where a force shows."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is known of a rig's noise; frozen, a new one after every window learnt.

    Attributes:
        log_sigma, log_sigma_var: (p,) log of each sensor's sd and its variance.
        power, dof: (K, p), (K, p) scaled inverse χ² of each bin's level: Σ normalised power, degrees of
            freedom.
        nodes, log_weight: (a, G) intensities of each source and their log-weights; empty before the first
            window.
        intensity: (a,) posterior mean of each.
        spread: (a, q) relative variance that the uncertainty of each intensity adds to each parameter.
        windows: windows learnt; turn: whose turn it is in the rotation.
        walk: variance of the random walk of log σ from window to window; counted: windows behind it.
    """

    log_sigma: FloatArray
    log_sigma_var: FloatArray
    power: FloatArray
    dof: FloatArray
    nodes: FloatArray
    log_weight: FloatArray
    intensity: FloatArray
    spread: FloatArray
    windows: int = 0
    turn: int = 0
    walk: float = tuning.SIGMA_WALK**2
    counted: float = tuning.SIGMA_WALK_DOF

    @classmethod
    def prior(cls, sigma: FloatArray, spread: FloatArray, bins: int, sources: int, q: int) -> "Noise":
        """Return what is known before the first window; sigma (p,), spread (p,) sd of its logarithm."""
        p = len(sigma)
        counted = np.full((bins, p), tuning.LEVEL_DOF)
        empty = np.zeros((sources, 0))
        return cls(
            np.log(sigma),
            spread**2,
            counted,
            counted.copy(),
            empty,
            empty,
            np.zeros(sources),
            np.zeros((sources, q)),
        )

    @property
    def levels(self) -> FloatArray:
        """(K, p) level of each bin."""
        return self.power / self.dof

    @property
    def unsure(self) -> float:
        """Variance of log σ, of the sensor known least, in the window to come."""
        return float(self.log_sigma_var.max()) + self.walk

    def differs_from(self, before: "Noise") -> bool:
        """Whether an intensity that is large moved by more than a share since an earlier window."""
        if not before.is_started:
            return True
        # what may as well be absent has a mean that moves by chance
        there = (before.intensity > tuning.LARGE_NODES * before.nodes[:, 0]) & (
            before.log_weight[:, 0] < -tuning.SURE
        )
        moved = np.abs(np.log(self.intensity[there] / before.intensity[there]))
        return bool((moved > tuning.UNSETTLED).any())

    def exceeds(self, before: "Noise") -> bool:
        """Whether the noise has grown: an intensity that doubled, or a sensor's sd a tenth larger."""
        there = np.maximum(2 * before.intensity, tuning.ACTIVE_NODES * self.nodes[:, 0])
        return bool((self.intensity > there).any() or (self.log_sigma > before.log_sigma + 0.1).any())

    def is_other_than(self, before: "Noise") -> bool:
        """Whether there is more or less noise than before, as in `exceeds`."""
        return not before.is_started or self.exceeds(before) or before.exceeds(self)

    @property
    def is_started(self) -> bool:
        """Whether the grids of intensities stand."""
        return bool(self.nodes.size)


def chance(dof: FloatArray | float, unsure: float) -> FloatArray:
    """Return the predictive sd of the logarithm of a residual's power, with variance `unsure` of log σ."""
    return np.asarray(np.sqrt(2 / dof + 4 * unsure))


def louder(power: FloatArray | float, dof: FloatArray | float, unsure: float) -> FloatArray:
    """Return by how much the noise of a window exceeds what was expected, from its residual's power over dof.

    As much of that is the window's own σ as the walk of σ allows for; less power than expected is no luck.
    """
    return np.asarray(np.maximum(power, 1.0) ** (4 * unsure / (4 * unsure + 2 / dof)))


@dataclass(frozen=True, slots=True)
class Ridge:
    """Prior precision R (base, base) and precision × mean b (base,) of a regression's columns."""

    R: FloatArray
    b: FloatArray


class NoiseFit:
    """Learns the noise from one window; holds S⁻¹ and the Gram while they move.

    Args:
        noise: what was known before.
        cells: directions and spectra of the sources.
        regression: the window.
        sources: whose intensities are sought.
        ridge: prior of the columns with the constants wide; its end-effect entries are set here.
    """

    def __init__(
        self, noise: Noise, cells: Cells, regression: Regression, sources: tuple[Source, ...], ridge: Ridge
    ) -> None:
        self.cells, self.sources, self.layout = cells, sources, regression.layout
        self.X, self._high = regression.without_jumps, regression.high
        self.R0, self.b = ridge.R, ridge.b
        self.log_sigma, self.log_sigma_var = noise.log_sigma.copy(), noise.log_sigma_var.copy()
        self.intensity = noise.intensity.copy()
        self.levels = noise.levels
        self.seen_power = np.zeros_like(noise.power)
        self.seen_dof = np.zeros_like(noise.dof)
        self.ends = Ends(cells.response, sources)

    # ------------------------------------------------------------------ S, S⁻¹ and the Gram at today's values
    def refresh(self) -> None:
        """Make S⁻¹, the high power and the Gram anew from today's values."""
        self.high = HighPower(self.cells.response, self._high, self.levels)
        self.S = self.cells.covariance(self.log_sigma, self.levels, self.intensity)
        self.Si = inverse_of(self.S)
        self.G = self.cells.gram(self.Si, self.X)
        self.G[-1, -1] += self.high.quadratic(self.Si)

    def ridge(self) -> FloatArray:
        """Return the prior precision with the end effects of unknown forces at their intensities."""
        R = self.R0.copy()
        ends = range(self.layout.ends.start, self.layout.ends.stop)
        R[ends, ends] = self.ends.precision(self.intensity)
        return R

    def restricted_log_likelihood(self) -> float:
        """Return the REML log-likelihood at today's values."""
        self.refresh()
        nb = self.layout.base
        M, g = self.G[:nb, :nb] + self.ridge(), self.G[:nb, nb] + self.b
        logdet = float(self.cells.weight @ log_determinants(self.S))
        rss = self.G[nb, nb] - g @ (inverse(M) @ g)
        ends = float(np.log(self.ends.precision(self.intensity)).sum())
        return -0.5 * (logdet + float(log_determinant(M)) - ends + float(rss))

    # ------------------------------------------------------------------ σ and the levels of bins
    def score_sigma(self, prior_mean: FloatArray, prior_var: FloatArray, carried: Noise, steps: int) -> None:
        """Fisher scoring of log σ by REML with a Gaussian prior, and EM of the bins' levels."""
        for _ in range(steps):
            self.refresh()
            residual, leverage = self._fitted()
            before = self.log_sigma
            self._score_step(residual, leverage, prior_mean, prior_var)
            if self.sources:
                self._level_step(residual, leverage, carried)
            if np.abs(self.log_sigma - before).max() < RESTING:
                break
        self.refresh()

    def _fitted(self) -> tuple[ComplexArray, FloatArray]:
        """S⁻¹ of the residual (kept, p), and diag S⁻¹ X M⁻¹ Xᵀ S⁻¹ (kept, p)."""
        nb, kept = self.layout.base, self.cells.kept
        V = inverse(self.G[:nb, :nb] + self.ridge())
        fit = V @ (self.G[:nb, nb] + self.b)
        Si = self.Si[:kept]
        residual = (Si @ (self.X[..., nb] - self.X[..., :nb] @ fit)[..., None])[..., 0]
        Y = (Si @ self.X[..., :nb]).reshape(-1, nb)
        leverage = ((Y.real @ V) * Y.real).sum(axis=1) + ((Y.imag @ V) * Y.imag).sum(axis=1)
        return residual, leverage.reshape(kept, -1)

    def _score_step(
        self, residual: ComplexArray, leverage: FloatArray, prior_mean: FloatArray, prior_var: FloatArray
    ) -> None:
        kept, cells = self.cells.kept, self.cells
        variance = np.exp(2 * self.log_sigma)
        levels = cells.cell_levels(self.levels)
        B = cells.weight[:, None] * levels
        diagonal = np.einsum("kcc->kc", self.Si).real
        quad = (B[:kept] * np.abs(residual) ** 2).sum(axis=0)
        high = self.Si[kept:]
        quad += np.einsum("kcc->c", high @ self.high.R @ high).real
        score = variance * (quad - (B * diagonal).sum(axis=0) + (B[:kept] * leverage).sum(axis=0))
        F = 2 * np.einsum("kc,kcd,kd->cd", B, np.abs(self.Si) ** 2, levels) * np.outer(variance, variance)
        H = F + np.diag(1.0 / prior_var)
        step = np.linalg.solve(H, score - (self.log_sigma - prior_mean) / prior_var)
        self.log_sigma = self.log_sigma + np.clip(step, -1.0, 1.0)
        self.log_sigma_var = np.diag(np.linalg.inv(H)).copy()

    def _level_step(self, residual: ComplexArray, leverage: FloatArray, carried: Noise) -> None:
        """Expected noise power a bin given the data (EM), added to what was carried."""
        kept, bins = self.cells.kept, self.cells.response.bins
        variance = np.exp(2 * self.log_sigma)
        diagonal = np.einsum("kcc->kc", self.Si).real
        own = variance * self.levels[:kept]
        # S is not below its own noise: where forces drown that, rounding must not make the power negative
        unseen = np.maximum(own - own**2 * diagonal[:kept], 0.0)
        power = (own**2 * (np.abs(residual) ** 2 + leverage) + unseen) / variance
        used = np.where(self.cells.weight[:kept] > 0, bins.multiplicity[:kept], 0.0)[:, None]
        self.seen_power[:kept] = used * power
        self.seen_dof[:kept] = used
        if bins.groups:
            Sg = self.Si[kept:][bins.group_of]
            z = (Sg @ self.high.r[..., None])[..., 0]
            unseen = np.maximum(1 - variance * diagonal[kept:][bins.group_of], 0.0)
            excess = variance * np.abs(z) ** 2 + unseen
            many = bins.multiplicity[bins.high][:, None]
            self.seen_power[bins.high] = many * self.levels[bins.high] * excess
            self.seen_dof[bins.high] = many
        self.levels = (carried.power + self.seen_power) / (carried.dof + self.seen_dof)

    # ------------------------------------------------------------------ intensities of the sources
    def scan(
        self, order: IntArray, carried: FloatArray, nodes: FloatArray, every: bool, pred: Ridge | None
    ) -> "Scan":
        """Go over the intensities one by one (exact Gauss-Seidel); S⁻¹ and the Gram follow by rank one."""
        scan = Scan(self, carried, nodes, every, pred)
        for a in order:
            scan.axis(int(a))
        return scan

    def joint(
        self, prior_mean: FloatArray, prior_var: FloatArray, nodes: FloatArray, steps: int = 25
    ) -> None:
        """Average-information REML in all log variances at once, for a first window (Gilmour et al. 1995)."""
        p = len(self.log_sigma)
        kept = self.cells.kept
        cells = self.cells
        d = np.concatenate(
            [np.broadcast_to(np.eye(p, dtype=complex), (len(cells.weight), p, p)), cells.D], axis=2
        )
        spectra = np.concatenate([cells.cell_levels(self.levels).T, cells.spectra])
        prior = np.concatenate([0.25 / prior_var, np.full(len(self.sources), 1e-2)])
        for _ in range(steps):
            self.refresh()
            v = np.concatenate([np.exp(2 * self.log_sigma), self.intensity**2])
            score, F = self._average_information(d, spectra, v, kept)
            score[:p] -= 2 * (self.log_sigma - prior_mean) * prior[:p]
            step = np.linalg.solve(F + np.diag(prior + 0.02 * np.diag(F)), score)
            step = np.clip(step, -1.5, 1.5)
            self.log_sigma = self.log_sigma + 0.5 * step[:p]
            grown = self.intensity * np.exp(0.5 * step[p:])
            self.intensity = np.clip(grown, nodes[:, 0], nodes[:, -1])
            if np.abs(step * (F.diagonal() > 0.1)).max() < 0.05:
                break
        self.refresh()

    def _average_information(
        self, d: ComplexArray, spectra: FloatArray, v: FloatArray, kept: int
    ) -> tuple[FloatArray, FloatArray]:
        """Score and information of the log variances v of the directions d."""
        nb, weight = self.layout.base, self.cells.weight
        V = inverse(self.G[:nb, :nb] + self.ridge())
        fit = V @ (self.G[:nb, nb] + self.b)
        SD = self.Si @ d
        SDH = SD.conj().transpose(0, 2, 1)
        count = len(v)
        power = np.empty((len(weight), count))
        residual = (self.X[..., nb] - self.X[..., :nb] @ fit)[..., None]
        power[:kept] = np.abs((SDH[:kept] @ residual)[..., 0]) ** 2
        if len(self.high.R):
            grouped = np.einsum("kaa->ka", SDH[kept:] @ self.high.R @ SD[kept:]).real
            power[kept:] = grouped / np.maximum(weight[kept:, None], 1e-300)
        Y = (SDH[:kept] @ self.X[..., :nb]).reshape(-1, nb)
        leverage = np.zeros((len(weight), count))
        lev = ((Y.real @ V) * Y.real).sum(axis=1) + ((Y.imag @ V) * Y.imag).sum(axis=1)
        leverage[:kept] = lev.reshape(kept, count)
        DD = d.conj().transpose(0, 2, 1) @ SD
        weighted = weight * spectra
        excess = power - np.einsum("kaa->ka", DD).real + leverage
        score = 0.5 * v * np.einsum("ak,ka->a", weighted, excess)
        F = (
            0.5
            * np.outer(v, v)
            * np.einsum("ak,kab,bk->ab", weighted, np.abs(DD) ** 2, spectra, optimize=True)
        )
        return score, F


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

    def axis(self, a: int) -> None:
        """Find the posterior of one intensity and move S⁻¹ and the Gram to its mean."""
        fit, kept = self.fit, self.fit.cells.kept
        shape = fit.cells.spectra[a]
        h = fit.cells.D[:, :, a]
        self.Sh = (fit.Si @ h[..., None])[..., 0]
        self.hSh = (h.conj() * self.Sh).sum(axis=1).real
        row = (self.Sh[:kept].conj()[:, None, :] @ fit.X)[:, 0]
        outer = row.real[:, :, None] * row.real[:, None, :]
        outer += row.imag[:, :, None] * row.imag[:, None, :]
        self.outer = outer.reshape(kept, -1)
        high = self.Sh[kept:]
        self.high = np.einsum("ka,kab,kb->k", high.conj(), fit.high.R, high).real
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
        fit.intensity[a] = float(weight @ self.nodes[a, lo:hi])
        if self.pred is not None and fit.sources[a].kind == "force":
            self.spread[a] = self._spread(a, self.nodes[a, lo:hi], weight, grams, ends)
        self._move((fit.intensity[a] ** 2 - before**2) * shape)

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
        grams = self._changed(change / growth)
        intensity = np.empty((len(v), len(fit.intensity)))
        intensity[:] = fit.intensity
        intensity[:, a] = v
        ends = fit.ends.precision(intensity)
        M = grams.copy()
        M[:, :nb, :nb] += fit.R0
        M[:, self.ends, self.ends] += ends
        M[:, nb, :nb] += fit.b
        M[:, :nb, nb] += fit.b
        # where the source would drown everything the rank-one change has no digits left
        drowned = grams[:, -1, -1] < DROWNED * fit.G[-1, -1]
        M[drowned] = self.one
        d = 1.0 / np.sqrt(np.maximum(M.diagonal(axis1=1, axis2=2), 1e-300))
        scaled = M * d[:, :, None] * d[:, None, :] + 1e-12 * self.one
        pivot = _log_pivots(scaled) - np.log(d)
        drowned |= ~np.isfinite(pivot).all(axis=1)
        pivot[drowned] = 0.0
        rss = np.exp(2 * pivot[:, nb])
        ends_log = np.log(ends).sum(axis=1)
        logs = -0.5 * (np.log(growth) @ fit.cells.weight + 2 * pivot[:, :nb].sum(axis=1) - ends_log + rss)
        return np.where(drowned, -np.inf, self.carried[a, lo:hi] + logs), grams, ends

    def _changed(self, w: FloatArray) -> FloatArray:
        """The Gram (..., base+1, base+1) when S grows by change · d d*.

        w = change / (1 + change d*S⁻¹d) (..., C).
        """
        fit = self.fit
        kept = self.fit.cells.kept
        size = self.fit.layout.base + 1
        low = (w[..., :kept] * fit.cells.weight[:kept]) @ self.outer
        G = fit.G - low.reshape(*w.shape[:-1], size, size)
        G[..., -1, -1] -= w[..., kept:] @ self.high
        return np.asarray(G)

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
        V = inverse(M)
        delta = (V[:, psi] @ (grams[:, :nb, nb] + pred.b)[..., None])[..., 0]
        variance = V.diagonal(axis1=1, axis2=2)[:, psi]
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
        fit.G = self._changed(w)
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


def learn(  # noqa: PLR0913, PLR0917
    noise: Noise,
    cells: Cells,
    regression: Regression,
    sources: tuple[Source, ...],
    wide: Ridge,
    pred: Ridge | None,
    least: FloatArray,
    shaken: bool = False,
    anew: bool = False,
) -> tuple[Noise, NoiseFit]:
    """Return the noise after one window, and the fit with its Gram at the new noise.

    wide: prior of the columns with the constants wide; pred: with the constants as known today, for the
    spread. least: (p,) least that log σ may turn out to be: the grids of intensities begin where sources show
    beside it. shaken: the window before was not explained: σ may have changed more than it usually does.
    anew: sources are looked for as in a first window.
    """
    start = noise
    if not noise.is_started:
        empty = np.zeros((len(sources), tuning.NODES))
        start = replace(noise, nodes=first_nodes(cells, least), log_weight=empty)
    if anew:
        start = replace(start, log_weight=tuning.SHAKEN * start.log_weight)
    fit = NoiseFit(start, cells, regression, sources, wide)
    walk = start.walk * (start.windows > 0) + 0.3**2 * shaken
    mean = start.log_sigma
    var = start.log_sigma_var + walk
    carried = np.maximum(tuning.FORGET * start.log_weight, tuning.LOWEST_LOG_WEIGHT)
    every = start.windows < 3
    order = _order(start)
    steps = 1 if start.windows else FIRST_STEPS
    if len(sources) and (anew or not start.windows):
        fit = _start(start, fit, mean, var)
    if every:
        # what is scanned first takes what two can explain: slow forces leave wider intervals than white ones
        order = np.argsort([source.pole == 0 for source in sources], kind="stable")
        fit.score_sigma(mean, var, start, steps)
        fit.scan(order, carried, start.nodes, every, None)
    fit.score_sigma(mean, var, start, steps)
    scan = fit.scan(order, carried, start.nodes, every, pred)
    return _after(start, fit, scan), fit


def _start(noise: Noise, fit: NoiseFit, mean: FloatArray, var: FloatArray) -> NoiseFit:
    """The best of three joint fits: forces and sensors, or either alone; coordinate steps are greedy."""
    best = -np.inf
    found = (fit.log_sigma, fit.intensity)
    forces = np.array([source.kind == "force" for source in fit.sources])
    as_sensors = np.clip(first_nodes(fit.cells, mean)[:, 5], noise.nodes[:, 0], noise.nodes[:, -1])
    for of_forces, of_sensors in ((True, True), (True, False), (False, True)):
        fit.log_sigma = mean.copy()
        chosen = np.where(forces, of_forces, of_sensors)
        fit.intensity = np.where(chosen, as_sensors, noise.nodes[:, 0])
        fit.joint(mean, var, noise.nodes)
        value = fit.restricted_log_likelihood()
        if value > best:
            best = value
            found = (fit.log_sigma, fit.intensity)
    fit.log_sigma, fit.intensity = found
    return fit


def _order(noise: Noise) -> IntArray:
    """Sources that are active, strongest first, and some of the others in rotation."""
    share = noise.intensity / noise.nodes[:, 0]
    active = np.flatnonzero(share > tuning.ACTIVE_NODES)
    active = active[np.argsort(-share[active])]
    many = 2 * tuning.ROTATION
    rest = np.concatenate([active[many:], np.setdiff1d(np.arange(len(share)), active)]).astype(np.int64)
    turn = (noise.turn + np.arange(min(tuning.ROTATION, len(rest)))) % max(len(rest), 1)
    return np.sort(np.concatenate([active[:many], rest[turn]])).astype(np.int64)


def _after(noise: Noise, fit: NoiseFit, scan: Scan) -> Noise:
    keep = tuning.FORGET
    spread, log_weight = noise.spread.copy(), noise.log_weight.copy()
    for a, value in scan.spread.items():
        spread[a] = value
    for a, logs in scan.log_weight.items():
        log_weight[a] = logs
    seen = fit.seen_dof > 0
    prior = tuning.LEVEL_DOF
    power = np.where(seen, prior + keep * (noise.power - prior) + fit.seen_power, noise.power)
    dof = np.where(seen, prior + keep * (noise.dof - prior) + fit.seen_dof, noise.dof)
    walk, counted = _walk_after(noise, fit)
    return Noise(
        fit.log_sigma, fit.log_sigma_var, power, dof, noise.nodes, log_weight, fit.intensity, spread,
        noise.windows + 1, noise.turn + tuning.ROTATION, walk, counted,
    )  # fmt: skip


def _walk_after(noise: Noise, fit: NoiseFit) -> tuple[float, float]:
    """Return the walk of log σ with one more step of it, and how many it rests on."""
    if not noise.windows:
        return noise.walk, noise.counted
    step = float(np.max((fit.log_sigma - noise.log_sigma) ** 2 - fit.log_sigma_var))
    kept = tuning.FORGET * noise.counted
    return (kept * noise.walk + max(step, 0.0)) / (kept + 1), kept + 1


def layout_free(layout: Layout) -> FloatArray:
    """Return the diagonal (base,) of the weakest prior: parameters within a thousand times their size."""
    free = np.zeros(layout.base)
    free[layout.psi] = 1e-6
    return free
