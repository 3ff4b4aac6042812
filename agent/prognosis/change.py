"""Whether a parameter changes, apart from the shape of the change: level, slope and curvature of block means.

    y = X β + e,   Cov e = diag(sd²) + s² R(τ) + a² S,   R = exp(−|Δt|/τ), at τ → ∞ a random walk

where S is a yearly season.

The variances are not known: each (s, τ, a) of a grid is weighed by its restricted likelihood (REML, Patterson
& Thompson 1971), and every answer is the mixture over the grid, the slope's interval the average over it. So
an interval is wide where a random walk cannot be told from scatter, and narrow where it can.
"""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.history import History, blocks, sound
from agent.prognosis.tuning import ASKED, FEWEST, LEAST, LINE, MEANS, SEASONAL, SHARES
from agent.types import BoolArray, FloatArray
from agent.units import YEAR_DAYS

HALF_WIDTH = 1.96
"""Fixed by statistics: of a 95 % interval, in standard deviations of a Gaussian."""
MONTHS = 12  # fixed by the calendar
SIZES = np.geomspace(0.02, 8.0, 13)
"""Standard deviations, in those of the differences of neighbours."""
STRENGTHS = (None, 0.3, 1.0, 3.0)
"""Of a yearly season, in standard deviations of the readings; None without one."""


@dataclass(frozen=True, slots=True)
class Change:
    """Level, slope and curvature at the newest row, and whether anything changes.

    Of fewer than FEWEST rows the newest slope is the whole line's, and the curvature 0 with an infinite sd.

    Attributes:
        level, level_sd: at the newest row.
        slope, slope_sd: of the line through the whole span; slope_lower, slope_upper: its 95 % interval.
        newest, newest_sd: slope of the newest half. rates: its density.
        curvature, curvature_sd: second derivative.
        p_whole, p_half: how probable as much change is without any, over the whole span and over its newest
            half.
        trend: whether either is below ASKED.
    """

    level: float
    level_sd: float
    slope: float
    slope_sd: float
    newest: float
    newest_sd: float
    curvature: float
    curvature_sd: float
    p_whole: float
    p_half: float
    rates: "Rates"

    @property
    def slope_lower(self) -> float:
        return self.slope - HALF_WIDTH * self.slope_sd

    @property
    def slope_upper(self) -> float:
        return self.slope + HALF_WIDTH * self.slope_sd

    @property
    def trend(self) -> bool:
        return min(self.p_whole, self.p_half) < ASKED


@dataclass(frozen=True, slots=True)
class Rates:
    """A slope as a mixture of Gaussians: means, standard deviations and weights (K,)."""

    mean: FloatArray
    sd: FloatArray
    weight: FloatArray

    def above(self, rate: float) -> float:
        """Return the probability of a slope above a rate."""
        from scipy.special import ndtr

        return float(self.weight @ ndtr((self.mean - rate) / self.sd))


@dataclass(frozen=True, slots=True)
class _Mixture:
    """Means (K, d), covariances (K, d, d) and weights (K,) of β over the grid of variances."""

    mean: FloatArray
    cov: FloatArray
    weight: FloatArray

    def moments(self, row: FloatArray) -> tuple[float, float]:
        """Return mean and sd of a linear function of β."""
        mean = self.mean @ row
        variance = np.einsum("kij,i,j->k", self.cov, row, row)
        centre = float(self.weight @ mean)
        return centre, float(np.sqrt(self.weight @ (variance + (mean - centre) ** 2)))

    def pooled(self, row: FloatArray) -> tuple[float, float]:
        """Return mean and sd of a linear function of β, the sds of the shapes averaged in their logarithms.

        The tails of a mixture are those of its widest shape, however seldom it is true: under each of the
        others they hold too much (Gneiting & Ranjan 2013). Quantiles are averaged (Ratcliff 1979); within a
        shape, where only its size is open, the mixture is Student's t and stays.
        """
        weight = self.weight.reshape(-1, len(SIZES))
        mean = (self.mean @ row).reshape(weight.shape)
        variance = np.einsum("kij,i,j->k", self.cov, row, row).reshape(weight.shape)
        share = np.maximum(weight.sum(axis=1), 1e-300)
        middle = np.sum(weight * mean, axis=1) / share
        spread = np.sum(weight * (variance + (mean - middle[:, None]) ** 2), axis=1) / share
        return float(share @ middle), float(np.exp(0.5 * share @ np.log(np.maximum(spread, 1e-300))))

    def rates(self, row: FloatArray, per: float) -> Rates:
        """Return the density of a linear function of β, times a factor."""
        sd = np.sqrt(np.einsum("kij,i,j->k", self.cov, row, row))
        return Rates(per * (self.mean @ row), per * np.maximum(sd, 1e-300), self.weight)

    def improbable(self, columns: list[int]) -> float:
        """Return how probable coefficients as far from 0 are where they are 0 (Wald), over the mixture."""
        from scipy.special import chdtrc

        mean = self.mean[:, columns]
        cov = self.cov[:, columns][:, :, columns]
        square = np.einsum("ki,ki->k", mean, np.linalg.solve(cov, mean[..., None])[..., 0])
        return float(self.weight @ chdtrc(len(columns), square))


def change(history: History, most: int = MEANS) -> Change | None:
    """Return the change of a history whose t is in days; None where it has fewer than 3 rows or no span."""
    thin = blocks(sound(history), most)
    if len(thin) < LINE or thin.span <= 0.0:
        return None
    t = (thin.t - thin.t[-1]) / thin.span
    digits = float(np.finfo(np.float64).eps * np.abs(thin.value).max())
    size = max(float(np.ptp(thin.value)), float(thin.sd.max()), digits, 1e-300)
    y = (thin.value - thin.value[-1]) / size
    rough = 1.4826 * float(np.median(np.abs(np.diff(y)))) + 1e-6
    sd = np.maximum(thin.sd / size, LEAST * rough)
    scatter = _Scatter.of(t, y, sd, rough, thin.span)
    one = np.ones_like(t)
    late = _newest_half(t).astype(np.float64)
    whole = _reml(np.column_stack([one, t]), y, scatter)
    if len(thin) < FEWEST:
        return _line(whole, float(thin.value[-1]), size, thin.span)
    bent = _reml(np.column_stack([one, t, 0.5 * t * t]), y, scatter)
    half = _reml(np.column_stack([1.0 - late, (1.0 - late) * t, late, late * t]), y, scatter)
    return _answer(whole, bent, half, float(thin.value[-1]), size, thin.span)


def _newest_half(t: FloatArray) -> BoolArray:
    """Return which rows are of the newest half of the span, or of the rows where a half has no line."""
    late = np.asarray(t >= -0.5)
    if min(late.sum(), (~late).sum()) < 2:
        late = np.arange(len(t)) >= len(t) // 2
    return late


@dataclass(frozen=True, slots=True)
class _Scatter:
    """What the readings may scatter by: shapes of correlation, each turned to its own axes, and a season.

    Attributes:
        roots: turns readings over sd to the axes of each shape, (m, m) each; eigenvalues: (m,) of each.
        log_prior: of each shape.
        sizes: (s,) standard deviations.
        season: (m, 2) cosine and sine of the year, or (m, 0).
    """

    roots: list[FloatArray]
    eigenvalues: list[FloatArray]
    log_prior: FloatArray
    sizes: FloatArray
    season: FloatArray

    @classmethod
    def of(cls, t: FloatArray, y: FloatArray, sd: FloatArray, rough: float, span: float) -> "_Scatter":
        step = float(np.median(np.diff(t)))
        apart = np.abs(t[:, None] - t[None, :]) / step
        white = np.eye(len(t))
        walk = (1.0 + np.minimum(t[:, None], t[None, :])) / step - np.eye(len(t)) / 6.0
        shapes = [
            white,
            *(np.exp(-apart / k) for k in (1.0, 2.5, 6.0)),
            walk,
            white + 0.1 * walk,
            white + 0.01 * walk,
        ]
        turned = [np.linalg.eigh(R / np.outer(sd, sd)) for R in shapes]
        season = _season(t * span / YEAR_DAYS)
        return cls(
            [(V / sd[:, None]).T for _, V in turned],
            [np.maximum(values, 0.0) for values, _ in turned],
            np.log(SHARES),
            rough * SIZES,
            season * float(np.std(y)),
        )


def _season(years: FloatArray) -> FloatArray:
    """Return cosine and sine of the year (m, 2), or (m, 0) where the readings leave too much of it out."""
    covered = len(np.unique(np.floor(years % 1.0 * MONTHS)))
    if years[-1] - years[0] <= SEASONAL or covered < SEASONAL * MONTHS:
        return np.zeros((len(years), 0))
    phase = 2.0 * np.pi * years
    return np.column_stack([np.cos(phase), np.sin(phase)])


def _reml(X: FloatArray, y: FloatArray, scatter: _Scatter) -> _Mixture:
    """Return β for each shape, size and strength of a season, weighed by its restricted likelihood."""
    p, seasonal = X.shape[1], scatter.season.shape[1]
    columns = np.column_stack([X, scatter.season, y])
    gram, log_det = [], []
    for root, values in zip(scatter.roots, scatter.eigenvalues, strict=True):
        turned = root @ columns
        spread = 1.0 + np.multiply.outer(scatter.sizes**2, values)
        gram.append(np.einsum("ki,ia,ib->kab", 1.0 / spread, turned, turned))
        log_det.append(np.log(spread).sum(axis=1))
    prior = np.repeat(scatter.log_prior, len(scatter.sizes)) - 0.5 * np.concatenate(log_det)
    found = [_weighed(np.concatenate(gram), p, a) for a in (STRENGTHS if seasonal else (None,))]
    log_weight = np.concatenate([prior + more for *_, more in found])
    weight = np.exp(log_weight - log_weight.max())
    return _Mixture(
        np.concatenate([f[0] for f in found]), np.concatenate([f[1] for f in found]), weight / weight.sum()
    )


def _weighed(gram: FloatArray, p: int, strength: float | None) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means, covariances of p coefficients and log restricted likelihoods; strength: of the season."""
    last = gram.shape[1] - 1
    free = np.arange(p if strength is None else last)
    A = gram[np.ix_(np.arange(len(gram)), free, free)]
    b = gram[:, free, last]
    precision = np.zeros(len(free))
    if strength is not None:
        precision[p:] = 1.0 / strength**2
    cov = np.linalg.inv(A + np.diag(precision))
    beta = np.einsum("kij,kj->ki", cov, b)
    square = gram[:, last, last] - np.einsum("ki,ki->k", b, beta)
    _, log_det = np.linalg.slogdet(cov)
    log_weight = 0.5 * (log_det - square + np.log(precision[p:]).sum())
    return beta[:, :p], cov[:, :p, :p], log_weight - (0.0 if strength is None else np.log(6.0))


def _line(whole: _Mixture, origin: float, size: float, span: float) -> Change:
    """Return what a line alone says."""
    level, level_sd = whole.moments(np.array([1.0, 0.0]))
    row = np.array([0.0, 1.0])
    per = size / span
    slope, slope_sd = (per * moment for moment in whole.pooled(row))
    p = whole.improbable([1])
    return Change(
        origin + size * level, size * level_sd, slope, slope_sd, slope, slope_sd, 0.0, np.inf, p, 1.0,
        whole.rates(row, per),
    )  # fmt: skip


def _answer(
    whole: _Mixture, bent: _Mixture, half: _Mixture, origin: float, size: float, span: float
) -> Change:
    level, level_sd = whole.moments(np.array([1.0, 0.0]))
    slope, slope_sd = whole.pooled(np.array([0.0, 1.0]))
    curvature, curvature_sd = bent.moments(np.array([0.0, 0.0, 1.0]))
    recent = np.array([0.0, 0.0, 0.0, 1.0])
    per = size / span
    newest, newest_sd = half.moments(recent)
    return Change(
        origin + size * level, size * level_sd, per * slope, per * slope_sd, per * newest, per * newest_sd,
        per / span * curvature, per / span * curvature_sd,
        bent.improbable([1, 2]), half.improbable([3]), half.rates(recent, per),
    )  # fmt: skip
