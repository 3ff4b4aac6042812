"""Restricted likelihood of one window's noise: scoring of σ and levels, and of all variances at once."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.spectral.algebra import inverse, log_determinant
from agent.numerics.inference.spectral.columns import Layout, Regression
from agent.numerics.inference.spectral.covariance import Cells, HighPower, inverse_of, log_determinants
from agent.numerics.inference.spectral.ends import Ends
from agent.numerics.inference.spectral.sources import Source
from agent.numerics.inference.tuning import RESTING
from agent.types import ComplexArray, FloatArray


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

    Attributes:
        there: (t,) sources whose variances are sought together with σ;  information: (t, t) of these, this
            window's in it once it was scored.
        looks: steps of joint fits, and whole grids looked at, so far.
    """

    def __init__(
        self, noise: Noise, cells: Cells, regression: Regression, sources: tuple[Source, ...], ridge: Ridge
    ) -> None:
        self.cells, self.sources, self.layout = cells, sources, regression.layout
        self.X, self._high = regression.without_jumps, regression.high
        self.R0, self.b = ridge.R, ridge.b
        # that of the columns and the residual
        self.prior = np.zeros((len(ridge.b) + 1,) * 2)
        self.prior[:-1, :-1] = ridge.R
        self.prior[-1, :-1] = self.prior[:-1, -1] = ridge.b
        self.log_sigma, self.log_sigma_var = noise.log_sigma.copy(), noise.log_sigma_var.copy()
        self.intensity = noise.intensity.copy()
        self._rounding = noise.white - np.exp(2 * noise.log_sigma)
        self.levels = noise.levels
        self.high = HighPower(cells.response, regression.high, noise.levels)
        self.seen_power = np.zeros_like(noise.power)
        self.seen_dof = np.zeros_like(noise.dof)
        self.ends = Ends(cells.response, sources, self.layout.lasting)
        self.there = noise.there(sources)
        self.information = noise.firmness(self.there, sources)
        self._firm = self.information
        self.looks = 0
        self._carried = noise.intensity[self.there] ** 2
        self._least = noise.nodes[self.there, :1].ravel() ** 2

    # ------------------------------------------------------------------ S, S⁻¹ and the Gram at today's values
    def refresh(self) -> None:
        """Make S⁻¹ and the Gram anew from today's values."""
        self.S = self.cells.covariance(self._white(), self.levels, self.intensity)
        self.Si = inverse_of(self.S)
        self.G = self.cells.gram(self.Si, self.X)
        self.G[-1, -1] += self.high.quadratic(self.Si)

    def _white(self) -> FloatArray:
        """Variance (p,) of white noise."""
        return np.exp(2 * self.log_sigma) + self._rounding

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
            residual, leverage, whole = self._fitted()
            before = self.log_sigma
            self._score_step(residual, leverage, whole, prior_mean, prior_var)
            if self.sources:
                self._level_step(residual, leverage, carried)
            if np.abs(self.log_sigma - before).max() < RESTING:
                break
        self.refresh()

    def _fitted(self) -> tuple[ComplexArray, FloatArray, ComplexArray]:
        """S⁻¹ of the residual (kept, p), and S⁻¹ X M⁻¹ Xᵀ S⁻¹: its diagonal (kept, p) and whole (kept, p, p).

        The whole of it is left empty where no source is there that asks for it.
        """
        nb, kept = self.layout.base, self.cells.kept
        V = inverse(self.G[:nb, :nb] + self.ridge())
        fit = V @ (self.G[:nb, nb] + self.b)
        Si = self.Si[:kept]
        residual = (Si @ (self.X[..., nb] - self.X[..., :nb] @ fit)[..., None])[..., 0]
        Y = Si @ self.X[..., :nb]
        if len(self.there):
            whole = (Y.reshape(-1, nb) @ V).reshape(Y.shape) @ Y.conj().transpose(0, 2, 1)
            return residual, np.einsum("kcc->kc", whole).real, whole
        Y = Y.reshape(-1, nb)
        leverage = ((Y.real @ V) * Y.real).sum(axis=1) + ((Y.imag @ V) * Y.imag).sum(axis=1)
        return residual, leverage.reshape(kept, -1), np.zeros((0, 0, 0), dtype=complex)

    def _score_step(
        self,
        residual: ComplexArray,
        leverage: FloatArray,
        whole: ComplexArray,
        prior_mean: FloatArray,
        prior_var: FloatArray,
    ) -> None:
        """One step of log σ, and with it of the intensities that are there: what one gives up others take."""
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
        g = score - (self.log_sigma - prior_mean) / prior_var
        if not len(self.there):
            self.log_sigma = self.log_sigma + np.clip(np.linalg.solve(H, g), -1.0, 1.0)
            self.log_sigma_var = np.diag(np.linalg.inv(H)).copy()
            return
        p = len(variance)
        more, cross, own = self._intensities(residual, whole, B)
        cross = cross * variance[:, None]
        now = self.intensity[self.there] ** 2
        H = np.block([[H, cross], [cross.T, own + self._firm]])
        g = np.concatenate([g, more - self._firm @ (now - self._carried)])
        step = bounded(H, g, np.concatenate([np.full(p, -1.0), self._least - now]))
        self.log_sigma = self.log_sigma + np.minimum(step[:p], 1.0)
        # beside a large variance the step's bound has no digits left of the least one
        found = np.clip(now + step[p:], self._least, tuning.GROWTH * now.max())
        self.intensity[self.there] = np.sqrt(found)
        self.log_sigma_var = np.diag(np.linalg.inv(H))[:p].copy()
        self.information = H[p:, p:] - H[p:, :p] @ np.linalg.solve(H[:p, :p], H[:p, p:])

    def _intensities(
        self, residual: ComplexArray, whole: ComplexArray, B: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Score (t,) of the variances of sources there, their information with σ² (p, t) and each other."""
        kept, there = self.cells.kept, self.there
        d, spectra, weight = self.cells.D[:, :, there], self.cells.spectra[there], self.cells.weight
        Sd = self.Si @ d
        low, high = d[:kept].conj().transpose(0, 2, 1), Sd[kept:].conj().transpose(0, 2, 1)
        between = d.conj().transpose(0, 2, 1) @ Sd
        shown = np.abs((low @ residual[..., None])[..., 0]) ** 2
        shown += np.einsum("ktc,kcd,kdt->kt", low, whole, d[:kept], optimize=True).real
        shown -= np.einsum("ktt->kt", between[:kept]).real
        above = np.einsum("ktt->kt", high @ self.high.R @ Sd[kept:]).real
        above -= weight[kept:, None] * np.einsum("ktt->kt", between[kept:]).real
        score = 0.5 * (np.einsum("k,tk,kt->t", weight[:kept], spectra[:, :kept], shown))
        score += 0.5 * np.einsum("tk,kt->t", spectra[:, kept:], above)
        cross = np.einsum("kc,kct,tk->ct", B, np.abs(Sd) ** 2, spectra)
        own = 0.5 * np.einsum("tk,ktu,uk->tu", weight * spectra, np.abs(between) ** 2, spectra, optimize=True)
        return score, cross, own

    def unsure(self, pred: Ridge) -> FloatArray:
        """Return the relative variance (q,) that not knowing the variances there adds to the parameters.

        A variance that is too large is so as often as too small; what it adds is how it moves the estimates.
        pred: prior of the columns with the constants as known.
        """
        kept, nb, there, psi = self.cells.kept, self.layout.base, self.there, self.layout.psi
        M = self.G[:nb, :nb] + pred.R
        ends = range(self.layout.ends.start, self.layout.ends.stop)
        M[ends, ends] = self.G[ends, ends] + self.ends.precision(self.intensity)
        V = inverse(M)
        fit = V @ (self.G[:nb, nb] + pred.b)
        shown = (self.Si[:kept] @ self.cells.D[:kept][:, :, there]).conj().transpose(0, 2, 1) @ self.X
        left = shown[..., nb] - shown[..., :nb] @ fit
        weight = (self.cells.weight * self.cells.spectra[there])[:, :kept]
        moved = V[psi] @ np.einsum("tk,ktb,kt->bt", weight, shown[..., :nb].conj(), left).real
        return np.asarray(np.einsum("qt,tu,qu->q", moved, inverse(self.information), moved) / np.diag(V)[psi])

    def _level_step(self, residual: ComplexArray, leverage: FloatArray, carried: Noise) -> None:
        """Expected noise power a bin given the data (EM), added to what was carried."""
        kept, bins = self.cells.kept, self.cells.response.bins
        variance = self._white()
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
        self.high = HighPower(self.cells.response, self._high, self.levels)

    # ------------------------------------------------------------------ all variances at once
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
            self.looks += 1
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
        columns = self.X[..., :nb]
        fitted = (columns.reshape(-1, nb) @ V).reshape(columns.shape) @ columns.conj().transpose(0, 2, 1)
        leverage = np.zeros((len(weight), count))
        leverage[:kept] = ((fitted @ SD[:kept]) * SD[:kept].conj()).sum(axis=1).real
        DD = d.conj().transpose(0, 2, 1) @ SD
        weighted = weight * spectra
        excess = power - np.einsum("kaa->ka", DD).real + leverage
        score = 0.5 * v * np.einsum("ak,ka->a", weighted, excess)
        F = 0.5 * np.outer(v, v) * np.einsum("ak,kab,bk->ab", weighted, np.abs(DD) ** 2, spectra)
        return score, F


def layout_free(layout: Layout) -> FloatArray:
    """Return the diagonal (base,) of the weakest prior: parameters within a thousand times their size."""
    free = np.zeros(layout.base)
    free[layout.psi] = 1e-6
    return free


def bounded(H: FloatArray, g: FloatArray, least: FloatArray) -> FloatArray:
    """Return x (k,) of the least ½ xᵀ H x − gᵀ x with x >= least, by principal pivoting.

    What violates its condition changes sides, all at once; after some rounds the last one alone, which ends
    (Júdice & Pires, Computers & Operations Research 21 (1994) 587).
    """
    d = 1.0 / np.sqrt(np.diag(H))
    H, g, least = H * np.outer(d, d), g * d, least / d
    x = least.copy()
    free = np.ones(len(g), dtype=bool)
    for turn in range(tuning.PIVOTS):
        x[~free] = least[~free]
        x[free] = np.linalg.solve(H[np.ix_(free, free)], g[free] - H[np.ix_(free, ~free)] @ x[~free])
        wrong = np.where(free, x < least, H @ x < g)
        if not wrong.any():
            break
        if turn >= len(g):
            wrong[: np.flatnonzero(wrong)[-1]] = False
        free ^= wrong
    return np.asarray(np.maximum(x, least) * d)
