"""Readings that are taken a little early or late: noise that goes with the speed of what is read.

A reading that is late by d is wrong by d times the rate at which its channel changes, so where the instants jitter the
noise has the variance rest + delay^2 rate^2, and windows of fast motion leave more than those of slow motion. The two
parts follow from a regression of squared residuals on squared rates, weighted by what each is worth.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.colour import autoregression

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
SURE = 5.0
"""Standard deviations by which squared residuals must go with squared rates."""
MATTERS = 0.1
"""Least share of the noise that must go with the rate: below that the gate has room for it."""
LEAST_REST = 0.01
"""Least share of the usual variance that is there at rest too: nothing is exact."""
DOUBT = 3.0
"""Standard deviations of the jitter within which a window leaves no more and no less than it should."""
LOOKS = 512
"""Samples of a window, evenly spread, at which its rates are looked at."""
GREATEST = 1e100
"""Squares beyond this, or below its inverse, are of no noise; theirs would leave the numbers."""
ROUNDS = 4
"""Times that the regression is weighted anew by what the one before found."""


def rates(y: FloatArray, period_s: float) -> FloatArray:
    """Return the rate (N-2, p) at which outputs y (N, p) change, by central differences."""
    return np.asarray((y[2:] - y[:-2]) / (2.0 * period_s))


@dataclass(frozen=True, slots=True)
class Jitter:
    """How the noise of the outputs goes with their rates.

    Attributes:
        delay2: variance of the instants, s^2.
        rest: (p,) variance at rest over the reference's, sigma^2.
        sigma: (p,) the reference of the noise.
        period_s: sampling period, s.
        precision: of delay2, one over its variance.
    """

    delay2: float
    rest: FloatArray
    sigma: FloatArray
    period_s: float
    precision: float

    def ratio(self, s2: FloatArray, v: FloatArray, index: IntArray, window: int) -> FloatArray:
        """Return the residual variance (N,) of windows over what their motion leads to expect, within its doubt.

        Args:
            s2: (N,) residual variances over the reference's.
            v: (S, p+m) samples.
            index: (N,) places in v of the windows' newest samples.
            window: samples of each.
        """
        back = np.arange(1, window - 1, -(-window // LOOKS))
        at = index[:, None] - back
        y = v[:, : len(self.sigma)]
        seen = np.mean((y[at + 1] - y[at - 1]) ** 2, axis=1) / (2.0 * self.period_s) ** 2
        # what noise adds to a difference of two readings
        noisy = 0.5 / self.period_s**2
        rate2 = np.maximum(seen - noisy * self.rest * self.sigma**2, 0.0) / (1.0 + noisy * self.delay2)
        at_rest, moving = float(np.mean(self.rest)), np.mean(rate2 / self.sigma**2, axis=1)
        doubt = DOUBT / np.sqrt(self.precision)
        least, most = (at_rest + max(self.delay2 + off, 0.0) * moving for off in (-doubt, doubt))
        return np.asarray(s2 / np.clip(s2, least, most))

    def with_another(self, other: "Jitter") -> "Jitter":
        """Return what this and another window of the same reference show together, each by its precision."""
        share = other.precision / (self.precision + other.precision)
        return replace(
            self, delay2=self.delay2 + share * (other.delay2 - self.delay2),
            rest=self.rest + share * (other.rest - self.rest), precision=self.precision + other.precision,
        )  # fmt: skip

    def variances(self, residual: FloatArray, y: FloatArray) -> FloatArray:
        """Return the variance (W, p) over the reference of readings y (W, p) of which a fit left residual (W, p)."""
        rate = np.pad(rates(y - residual * self.sigma, self.period_s), ((1, 1), (0, 0)), mode="edge")
        return np.asarray(self.rest + self.delay2 * rate**2 / self.sigma**2)


def find_jitter(
    residual: FloatArray, y: FloatArray, sigma: FloatArray, stated: BoolArray, period_s: float, known: Jitter | None
) -> Jitter | None:
    """Return the jitter that a window's residual shows; what is known where that shows none, or is no white noise.

    Args:
        residual: (W, p) what a fit left, in units of sigma.
        y: (W, p) readings.
        sigma: (p,) the reference of the noise.
        stated: (p,) true where it is stated, which is of a sensor at rest; else it is the mean of some window.
        period_s: sampling period, s.
        known: what earlier windows showed; None for nothing.
    """
    # the rates of what the model says, which have no noise of their own
    rate2 = (rates(y - residual * sigma, period_s) / sigma) ** 2
    squares = residual[1:-1] ** 2
    mean = squares.mean(axis=0)
    if not (np.all((mean > 1.0 / GREATEST) & (mean < GREATEST)) and 0 < rate2.max() < GREATEST):
        return known
    delay2, rest, precision = _line(squares, rate2, np.broadcast_to(mean, squares.shape))
    sure = delay2 * np.sqrt(precision) > SURE
    for _ in range(ROUNDS):
        rest = np.maximum(rest, LEAST_REST * mean)
        delay2, rest, precision = _line(squares, rate2, rest + max(delay2, 0.0) * rate2)
    rest = np.maximum(rest, LEAST_REST * mean)
    matters = delay2 * float(np.mean(rate2)) > MATTERS * float(np.mean(mean))
    if (known is None and not (sure and matters)) or delay2 < 0:
        return known
    level = residual[1:-1] / np.sqrt(rest + delay2 * rate2)
    if any(len(autoregression(column)[0]) for column in level.T):
        return known
    rest = np.where(stated, 1.0, np.minimum(rest, 1.0))
    found = Jitter(delay2, rest, sigma, period_s, precision)
    return found if known is None else known.with_another(found)


def _line(squares: FloatArray, rate2: FloatArray, variance: FloatArray) -> tuple[float, FloatArray, float]:
    """Return the slope of squares (N, p) over rate2 (N, p), the same for all, their rests (p,), the slope's precision.

    variance (N, p) is what the squares are expected to be; they scatter by sqrt(2) of it.
    """
    weight = 0.5 / variance**2
    total = weight.sum(axis=0)
    x, y = rate2 - np.sum(weight * rate2, axis=0) / total, squares - np.sum(weight * squares, axis=0) / total
    precision = float(np.sum(weight * x * x))
    slope = float(np.sum(weight * x * y)) / max(precision, 1e-300)
    rest = np.sum(weight * (squares - slope * rate2), axis=0) / total
    return slope, rest, precision
