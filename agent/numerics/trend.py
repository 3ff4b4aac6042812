"""Drift of a parameter: a weighted line through its estimates, with an interval that correlation does not narrow.

Rows of one window each overlap, so neighbours share samples: only disjoint windows count. What slower causes add
(temperature, load) shows in the scatter of block means, and in their lag-one correlation ρ, which leaves
m (1 − ρ)/(1 + ρ) of m blocks (Bayley & Hammersley 1946); both widen the interval, neither ever narrows it.

    y(t) = a + b (t − t_now),   weights 1/sd²,   Cov = f² (XᵀWX)⁻¹,   f² = max(1, χ²/(m − 2)) (1 + ρ)/(1 − ρ)
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.types import FloatArray, IntArray

DAY_NS = 86_400_000_000_000
BLOCKS = 24
"""Means that the line is drawn through: enough for Student's t, few enough to show slow correlation."""


@dataclass(frozen=True, slots=True)
class Trend:
    """A line at the newest row; None where the rows cannot tell.

    Attributes:
        value, sd: of the line at the newest row, in the parameter's unit.
        slope_per_day, slope_sd, slope_lower, slope_upper: drift and its 95 % interval by Student's t, unit a day.
        trend: whether that interval leaves zero out.
        n_disjoint: windows that share no sample and so count.
    """

    value: float | None = None
    sd: float | None = None
    slope_per_day: float | None = None
    slope_sd: float | None = None
    slope_lower: float | None = None
    slope_upper: float | None = None
    trend: bool = False
    n_disjoint: int = 0


def fit_trend(t_ns: IntArray, value: FloatArray, sd: FloatArray, span_s: FloatArray) -> Trend:
    """Fit the drift of one parameter.

    t_ns, value, sd (n,): valid rows in the order of time, sd > 0. span_s (n,): the time each row rests on, its window
    or the period that it is the mean of. Three disjoint rows are needed for a slope's interval, two for a slope.
    """
    rows = disjoint(t_ns, span_s)
    if not len(rows):
        return Trend()
    days = (t_ns[rows] - t_ns[-1]) / DAY_NS
    at, mean, spread = _block_means(days, value[rows], sd[rows])
    if len(rows) == 1 or at[0] == at[-1]:
        return Trend(value=float(mean[-1]), sd=float(spread[-1]), n_disjoint=len(rows))
    return _line(at, mean, spread, len(rows))


def disjoint(t_ns: IntArray, span_s: FloatArray) -> NDArray[np.intp]:
    """Return the rows, newest kept, whose spans (t − span, t] share nothing; t_ns (n,) in the order of time."""
    starts = t_ns - np.round(span_s * 1e9).astype(np.int64)
    if len(t_ns) < 2 or bool((t_ns[:-1] <= starts[1:]).all()):
        return np.arange(len(t_ns))
    before = (np.searchsorted(t_ns, starts, side="right") - 1).tolist()
    chain = []
    row = len(t_ns) - 1
    while row >= 0:
        chain.append(row)
        row = min(before[row], row - 1)  # a row without a span still precedes itself
    return np.array(chain[::-1], dtype=np.intp)


def _block_means(t: FloatArray, y: FloatArray, sd: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weighted means of at most BLOCKS runs of rows: instants, values, standard deviations."""
    if len(t) <= BLOCKS:
        return t, y, sd
    starts = np.linspace(0, len(t), BLOCKS, endpoint=False).astype(np.intp)
    weight = sd.min() ** 2 / sd**2
    total = np.add.reduceat(weight, starts)
    means = [np.add.reduceat(weight * x, starts) / total for x in (t, y)]
    return means[0], means[1], sd.min() / np.sqrt(total)


def _line(t: FloatArray, y: FloatArray, sd: FloatArray, n: int) -> Trend:
    """Draw the line through block means and widen what it says by their scatter and correlation."""
    unit = -t[0]
    X = np.column_stack([1.0 / sd, t / unit / sd])
    R_inv = np.linalg.inv(np.linalg.qr(X, mode="r"))
    theta = R_inv @ (R_inv.T @ (X.T @ (y / sd)))
    widening, freedom = _widening(y / sd - X @ theta)
    sigma = widening * np.sqrt((R_inv**2).sum(axis=1))
    slope, slope_sd = float(theta[1] / unit), float(sigma[1] / unit)
    line = Trend(float(theta[0]), float(sigma[0]), slope, slope_sd, n_disjoint=n)
    if freedom <= 0.0:
        return line
    half = _quantile(freedom) * slope_sd
    return replace(line, slope_lower=slope - half, slope_upper=slope + half, trend=abs(slope) > half)


def _widening(residual: FloatArray) -> tuple[float, float]:
    """Return the factor on standard deviations and the degrees of freedom that m standardised residuals leave."""
    m = len(residual)
    square = float(residual @ residual)
    if m <= 2 or square == 0.0:
        return 1.0, float(m - 2)
    scatter = max(1.0, square / (m - 2))
    # Fitting a line takes about (2 + 4 ρ)/m from the lag-one correlation that is seen.
    lag_one = float(residual[1:] @ residual[:-1]) / square
    rho = min(max((m * lag_one + 2.0) / (m - 4.0), 0.0), 0.9) if m > 6 else 0.0
    fewer = (1.0 - rho) / (1.0 + rho)
    return math.sqrt(scatter / fewer), max(1.0, (m - 2) * fewer)


def _quantile(freedom: float) -> float:
    """Return the 97.5 % point of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))
