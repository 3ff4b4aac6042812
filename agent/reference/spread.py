"""Robust location and spread of a slow series: means of equal periods, their autocorrelation counted.

A parameter's rows scatter within an hour by what windows tell, and their means from hour to hour by what the
machine and its surroundings do. The location is Huber's (1964) of the period means; the spread their
winsorised deviation from it. Means that depend on one another are fewer than they look: n_effective = n / (1
+ 2 sum of autocorrelations), the sum cut where pairs of them turn negative (Geyer 1992, Statistical Science
7, section 3.3).
"""

from dataclasses import dataclass

import numpy as np

from agent.reference.tuning import CLIPPED, LEAST_DAYS, LEAST_PAIRS, OUTLIER
from agent.types import BoolArray, FloatArray, IntArray
from agent.units import DAY_S

HUBER = 1.345
"""Fixed by Huber 1981: robust deviations beyond which a period's mean weighs less: 95 % efficient on normal
data (Huber 1981)."""
EFFICIENCY = 0.95  # fixed by Huber 1981: of that mean
MAD = 1.4826
"""Fixed by statistics: from the median absolute deviation to the standard deviation of a normal
distribution."""


@dataclass(frozen=True, slots=True)
class Spread:
    """What a series is like.

    Attributes:
        reference, sd: location, and how well it is known.
        spread_sd: deviation of period means about it.
        within_sd: deviation of rows about their period's mean.
        days_sd: deviation of daily means; None from fewer than three days.
        correlation_s: time constant of the means' autocorrelation, at least half a period.
        n_effective: number of independent means that tell as much.
    """

    reference: float
    sd: float
    spread_sd: float
    within_sd: float
    days_sd: float | None
    correlation_s: float
    n_effective: float


def periods(t_s: FloatArray, period_s: float) -> IntArray:
    """Return the number of the period (n,) that each instant lies in, counted from the first instant."""
    return np.asarray(np.floor((t_s - t_s[0]) / period_s).astype(np.int64))


def spread(t_s: FloatArray, value: FloatArray, period_s: float) -> Spread:
    """Return location and spread of rows t_s (n,), value (n,), in time order, from at least two periods."""
    number = periods(t_s, period_s)
    first = np.flatnonzero(np.r_[True, np.diff(number) > 0])
    kept, within = _sound(value, first)
    return _of_means(_means(value, kept, first), number[first], t_s[first], within, period_s)


@dataclass(frozen=True, slots=True)
class Grouping:
    """Rows by period: which begin one, which are no outliers of theirs, and the periods' numbers (m,)."""

    first: IntArray
    kept: BoolArray
    number: IntArray

    def means(self, x: FloatArray) -> FloatArray:
        """Return the mean (m,) of each period of what rows x (n,) say."""
        return _means(x, self.kept, self.first)


def grouping(t_s: FloatArray, value: FloatArray, period_s: float) -> Grouping:
    """Return rows t_s (n,), value (n,), in order of time, by period."""
    number = periods(t_s, period_s)
    first = np.flatnonzero(np.r_[True, np.diff(number) > 0])
    return Grouping(first, _sound(value, first)[0], number[first])


def _sound(value: FloatArray, first: IntArray) -> tuple[BoolArray, float]:
    """Return which rows are no outliers of their period, and the deviation of rows in one."""
    count = np.diff(np.r_[first, len(value)])
    middle = np.repeat([float(np.median(part)) for part in np.split(value, first[1:])], count)
    within = MAD * float(np.median(np.abs(value - middle)))
    return np.asarray(np.abs(value - middle) <= max(OUTLIER * within, 0.0)), within


def _means(x: FloatArray, kept: BoolArray, first: IntArray) -> FloatArray:
    return np.asarray(
        np.add.reduceat(np.where(kept, x, 0.0), first) / np.maximum(np.add.reduceat(kept, first), 1)
    )


def _of_means(mean: FloatArray, number: IntArray, t_s: FloatArray, within: float, period_s: float) -> Spread:
    reference = huber(mean)
    cut = _clipped(mean - reference)
    together = correlation_sum(cut, number)
    independent = max(len(mean) / together, 1.0)
    of_means = _enlarged(float(np.mean(cut**2)), independent)
    days, by_days = _between_days(mean, np.floor(t_s / DAY_S).astype(np.int64))
    variance = max(of_means, by_days)
    return Spread(
        reference=reference,
        sd=float(np.sqrt(variance / independent / EFFICIENCY)),
        spread_sd=float(np.sqrt(variance)),
        within_sd=within,
        days_sd=days,
        correlation_s=0.5 * together * period_s,
        n_effective=independent,
    )


def huber(x: FloatArray) -> float:
    """Return Huber's location of numbers (n,), their scale the median absolute deviation."""
    found = float(np.median(x))
    scale = MAD * float(np.median(np.abs(x - found)))
    if scale == 0.0:
        return found
    for _ in range(50):
        apart = np.abs(x - found)
        weight = np.minimum(1.0, HUBER * scale / np.maximum(apart, 1e-300))
        found = float(weight @ x / weight.sum())
    return found


def _clipped(residual: FloatArray) -> FloatArray:
    """Return deviations cut at what a healthy one seldom reaches; half equal leaves all as they are."""
    scale = MAD * float(np.median(np.abs(residual)))
    return np.clip(residual, -CLIPPED * scale, CLIPPED * scale) if scale > 0.0 else residual


def _enlarged(variance: float, independent: float) -> float:
    """Return a variance about a location that was taken from the same few numbers, without that bias."""
    return variance * independent / max(independent - 1.0, 0.5)


def correlation_sum(x: FloatArray, number: IntArray) -> float:
    """Return 1 + 2 sum of autocorrelations of x (n,), at least 1; number (n,) their places, some absent."""
    length = int(number[-1] - number[0]) + 1
    row = np.zeros(length)
    there = np.zeros(length)
    row[number - number[0]] = x
    there[number - number[0]] = 1.0
    power = np.fft.rfft(row, 2 * length), np.fft.rfft(there, 2 * length)
    products, pairs = (np.fft.irfft(np.abs(part) ** 2)[: length // 2 + 1] for part in power)
    known: BoolArray = pairs > LEAST_PAIRS - 0.5
    if not products[0] > 0.0:
        return 1.0
    rho = np.where(known, products / np.maximum(pairs, 1.0), 0.0) / (products[0] / pairs[0])
    twos = rho[: 2 * (len(rho) // 2)].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(twos <= 0.0)) if (twos <= 0.0).any() else len(twos)
    return max(2.0 * float(twos[:end].sum()) - 1.0, 1.0)


def _between_days(mean: FloatArray, day: IntArray) -> tuple[float | None, float]:
    """Return the deviation of daily means, and the variance of a period's mean from it and that in a day."""
    first = np.flatnonzero(np.r_[True, np.diff(day) > 0])
    days = len(first)
    if days < LEAST_DAYS:
        return None, 0.0
    count = np.diff(np.r_[first, len(day)])
    daily = np.add.reduceat(mean, first) / count
    between = _enlarged(float(np.mean(_clipped(daily - huber(daily)) ** 2)), float(days))
    inside = float(np.mean(_clipped(mean - np.repeat(daily, count)) ** 2))
    return float(np.sqrt(between)), between + inside
