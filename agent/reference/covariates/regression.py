"""Regression of a parameter on covariates: coefficient, lag and their intervals, by likelihood.

    y_i = r + sum_j beta_j x_j(t_i; lag_j) + e_i,    e a first-order autoregression over the periods there are

For given lags and autocorrelation the coefficients are generalised least squares (Aitken 1935), the noise
whitened by e_i' = (e_i - rho^d e_{i-1}) / sqrt(1 - rho^2d), d the periods between. rho and each lag are taken
from grids by their likelihood; what the lag leaves open is in the interval of the coefficient (a mixture over
the lags by their likelihood, Hoeting et al. 1999). A covariate stays only where it is worth its two numbers
by Schwarz's criterion (1978).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, log, sqrt

import numpy as np

from agent.reference.covariates.lags import Lag
from agent.reference.spread import MAD, correlation_sum
from agent.reference.tuning import ALIKE, CLIPPED, CORRELATIONS, LENGTHS, PART, ROUNDS, SHORTEST_S
from agent.types import FloatArray, IntArray

FINE = tuple(2.0 ** (k / 12) for k in (-4, -3, -2, -1, 1, 2, 3, 4))
"""Lags beside the best of the coarse grid that are weighed too."""
WITHIN = 1.92
"""Fixed by statistics: log-likelihood below the best at which a lag is no longer in its 95 % interval: half
of chi-squared(1)."""

Columns = Callable[[int, Lag], FloatArray]
"""Covariate by number, and lag -> what acts of it in each period (n,)."""
Weighed = tuple[Lag, float, float, float]
"""A lag, its log-likelihood, the coefficient there and its sd."""


@dataclass(frozen=True, slots=True)
class Found:
    """What was found of one covariate.

    Attributes:
        coefficient, sd: change of the parameter a unit of the covariate.
        lag: the most probable; lag_lower_s, lag_upper_s: of its shape, those that are as good as it.
        gain: log-likelihood that it is worth; significant: whether that is worth its two numbers.
    """

    coefficient: float
    sd: float
    lag: Lag
    lag_lower_s: float
    lag_upper_s: float
    gain: float
    significant: bool


def lags(span_s: float) -> list[Lag]:
    """Return the lags that are weighed on a stretch of so many seconds."""
    lengths = [SHORTEST_S * 2.0 ** (0.5 * i) for i in range(LENGTHS)]
    allowed = [length for length in lengths if length <= span_s / PART]
    return [Lag(), *(Lag("first-order", s) for s in allowed), *(Lag("delay", s) for s in allowed)]


def regress(y: FloatArray, number: IntArray, columns: Columns, count: int, span_s: float) -> list[Found]:
    """Return what means y (n,) of periods number (n,) depend on, covariate by covariate.

    columns: of `count` covariates. span_s: length of the stretch.
    """
    fit = _Fit(number)
    chosen = [Lag()] * count
    kept = list(range(count))
    weighed: dict[int, list[Weighed]] = {}
    for _ in range(min(ROUNDS, count)):
        cut = fit.cut(y, [columns(j, chosen[j]) for j in kept])
        for j in kept:
            others = [columns(i, chosen[i]) for i in kept if i != j]
            weighed[j] = _weighed(fit, cut, others, partial(columns, j), lags(span_s))
            chosen[j] = max(weighed[j], key=_likelihood)[0]
    found = []
    for j in kept:
        others = [columns(i, chosen[i]) for i in kept if i != j]
        cut = fit.cut(y, [*others, columns(j, chosen[j])])
        fine = (
            [Lag(chosen[j].shape, chosen[j].seconds * ratio) for ratio in FINE] if chosen[j].seconds else []
        )
        both = _weighed(fit, cut, others, partial(columns, j), [*lags(span_s), *fine])
        known = _found(both, fit.last(cut, others)[0], log(len(y)))
        wider = known.sd * fit.inflation(cut, [*others, columns(j, known.lag)])
        found.append(replace(known, sd=wider))
    return found


def _weighed(
    fit: "_Fit",
    y: FloatArray,
    others: list[FloatArray],
    column: Callable[[Lag], FloatArray],
    asked: Sequence[Lag],
) -> list[Weighed]:
    """Return what each lag is worth beside other columns."""
    return [(lag, *fit.last(y, [*others, column(lag)])) for lag in asked]


def _likelihood(one: Weighed) -> float:
    return one[1]


def _found(weighed: Sequence[Weighed], without: float, worth: float) -> Found:
    """Return the mixture over lags."""
    lag, best, coefficient, _ = max(weighed, key=_likelihood)
    weight = np.exp(np.array([one[1] for one in weighed]) - best)
    weight /= weight.sum()
    values = np.array([one[2] for one in weighed])
    sds = np.array([one[3] for one in weighed])
    variance = float(weight @ (sds**2 + (values - coefficient) ** 2))
    of_shape = sorted((one for one in weighed if one[0].shape == lag.shape), key=lambda one: one[0].seconds)
    places = [place for place, one in enumerate(of_shape) if one[1] >= best - WITHIN]
    around = of_shape[max(places[0] - 1, 0)], of_shape[min(places[-1] + 1, len(of_shape) - 1)]
    between = (
        max(abs(one[2] - coefficient) for one in around) / 2.0
    )  # the truth may lie between lags of the grid
    gain = best - without
    sd = hypot(sqrt(variance), between)
    return Found(coefficient, sd, lag, around[0][0].seconds, around[1][0].seconds, gain, gain > worth)


class _Fit:
    """Generalised least squares of periods number (n,) under each autocorrelation of the grid."""

    def __init__(self, number: IntArray) -> None:
        apart = np.diff(number).astype(np.float64)
        self._number = number
        self._ways = [_way(rho, apart) for rho in CORRELATIONS]

    def last(self, y: FloatArray, columns: Sequence[FloatArray]) -> tuple[float, float, float]:
        """Return the log-likelihood, and coefficient and sd of the last column; 0, 0 where there is none."""
        X = np.column_stack([*columns, np.ones(len(y))])
        return max(self._one(y, X, way) for way in self._ways)

    def inflation(self, y: FloatArray, columns: Sequence[FloatArray]) -> float:
        """Return by how much the last column's sd must grow where the noise is slower than an autoregression.

        From the autocorrelation of the scores of its coefficient (Newey and West 1987).
        """
        X = np.column_stack([*columns, np.ones(len(y))])
        left, scale, _ = max(self._ways, key=lambda way: self._one(y, X, way)[0])
        Z = np.column_stack([X, y])
        Z[1:] = (Z[1:] - left[:, None] * Z[:-1]) * scale[:, None]
        last = X.shape[1] - 2
        rest = np.delete(Z[:, :-1], last, axis=1)
        own = Z[:, last] - rest @ np.linalg.lstsq(rest, Z[:, last], rcond=None)[0]
        residual = Z[:, -1] - Z[:, :-1] @ np.linalg.lstsq(Z[:, :-1], Z[:, -1], rcond=None)[0]
        return sqrt(correlation_sum(own * residual, self._number))

    def cut(self, y: FloatArray, columns: Sequence[FloatArray]) -> FloatArray:
        """Return y with residuals cut that no healthy period has."""
        X = np.column_stack([*columns, np.ones(len(y))])
        coefficients, *_ = np.linalg.lstsq(X, y, rcond=None)
        residual = y - X @ coefficients
        middle = float(np.median(residual))
        scale = CLIPPED * MAD * float(np.median(np.abs(residual - middle)))
        return y if scale == 0.0 else y - residual + middle + np.clip(residual - middle, -scale, scale)

    def _one(
        self, y: FloatArray, X: FloatArray, way: tuple[FloatArray, FloatArray, float]
    ) -> tuple[float, float, float]:
        left, scale, logs = way
        Z = np.column_stack([X, y])
        Z[1:] = (Z[1:] - left[:, None] * Z[:-1]) * scale[:, None]
        n, q = X.shape
        moment = Z.T @ Z
        inverse = np.linalg.pinv(moment[:q, :q], hermitian=True)
        theta = inverse @ moment[:q, q]
        rest = max(float(moment[q, q] - moment[q, :q] @ theta), 1e-300)
        variance = rest / max(n - q, 1)
        likelihood = -0.5 * n * log(rest / n) - logs
        if q == 1:
            return likelihood, 0.0, 0.0
        return likelihood, float(theta[q - 2]), sqrt(max(variance * float(inverse[q - 2, q - 2]), 0.0))


def _way(rho: float, apart: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return by what the value before is taken off and the rest multiplied, and the sum of its logarithms."""
    left = rho**apart if rho else np.zeros(len(apart))
    scale = 1.0 / np.sqrt(1.0 - left**2)
    return left, scale, -float(np.log(scale).sum())


def alike(columns: FloatArray) -> tuple[int, int] | None:
    """Return two of the columns (n, q) that move too closely together to be told apart; None for none."""
    if columns.shape[1] < 2:
        return None
    together = np.abs(np.corrcoef(columns.T))
    found = np.argwhere(np.triu(together > ALIKE, 1))
    return None if not len(found) else (int(found[0][0]), int(found[0][1]))
