"""Lagged covariates: what a machine feels of a temperature, load or speed that is measured beside it.

A covariate is a series of means of equal periods (`PERIOD_S`), numbered since the epoch; a period without a
reading is absent. What the machine feels of it is one of

    none          x[p] = c[p]
    delay         x[p] = c[p - d]
    first-order   x[p] = a x[p-1] + (1 - a) c[p],  a = exp(-T/tau)

The last is a body that warms through (Franklin, Powell 1998).

c counted from its centre. A gap is filled with the reading before it for `hold` periods; what is longer is
guessed from the days before, and `known` is the share of the weights that rests on readings: 1 where all are
there, 0 where none is.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Literal, NamedTuple

import numpy as np

from agent.reference.tuning import CLOSED, DRIFTS, MOST_GAP, RECENT, UNREAD
from agent.types import BoolArray, FloatArray, IntArray
from agent.units import MINUTE_NS

PERIOD_S = 60.0
"""Fixed by the store: means are of whole minutes: what a mean of a covariate is taken over."""

Shape = Literal["none", "delay", "first-order"]


@dataclass(frozen=True, slots=True)
class Lag:
    """How a machine follows a covariate; seconds: the delay, or the time constant."""

    shape: Shape = "none"
    seconds: float = 0.0

    @property
    def kept(self) -> float:
        """The share of what acted that is left a period later."""
        return float(np.exp(-PERIOD_S / self.seconds)) if self.shape == "first-order" else 0.0

    @property
    def periods(self) -> int:
        """Whole periods of a delay."""
        return round(self.seconds / PERIOD_S) if self.shape == "delay" else 0


def newest_period(t_ns: IntArray) -> IntArray:
    """Return the newest period (n,) that rows at these instants rest on."""
    return np.asarray(t_ns // MINUTE_NS - CLOSED)


@dataclass(frozen=True, slots=True)
class Series:
    """A covariate over consecutive periods from `first`: deviations from centre, guessed unless `covered`."""

    first: int
    deviation: FloatArray
    covered: BoolArray

    def lagged(self, lag: Lag) -> FloatArray:
        """Return what acts in each period (n,); before the first the covariate is taken to be as in that."""
        return _lagged(self.deviation, lag, float(self.deviation[0]))

    def known(self, lag: Lag) -> FloatArray:
        """Return the share (n,) of that which is known; of what was before the first period nothing is."""
        return _lagged(self.covered.astype(np.float64), lag, 0.0)


def series(number: IntArray, value: FloatArray, center: float, hold: int) -> Series:
    """Return means value (n,) of periods number (n,), ordered, on the grid; gaps are held so many periods."""
    length = int(number[-1] - number[0]) + 1
    place = number - number[0]
    age = np.arange(length)
    there = np.zeros(length, dtype=np.int64)
    there[place] = place
    newest = np.maximum.accumulate(there)
    deviation = np.zeros(length)
    deviation[place] = value - center
    covered = age - newest <= hold
    return Series(int(number[0]), deviation[newest], np.asarray(covered))


def _lagged(x: FloatArray, lag: Lag, before: float) -> FloatArray:
    if lag.shape == "none":
        return x
    if lag.shape == "delay":
        lead = np.full(min(lag.periods, len(x)), before)
        return np.concatenate([lead, x[: len(x) - len(lead)]])
    return _filtered(x, lag.kept, before)


def _filtered(x: FloatArray, kept: float, before: float) -> FloatArray:
    """Return the first-order lag of a series: the solution of a matrix of two bands."""
    from scipy.linalg import solve_banded

    right = (1.0 - kept) * x
    right[0] += kept * before
    bands = np.ones((2, len(x)))
    bands[1] = -kept
    return np.asarray(solve_banded((1, 0), bands, right, overwrite_b=True, check_finite=False))


class Lagged(NamedTuple):
    """What acts of a covariate: its deviation from the centre, the known share of it, how old it is.

    inflation: by how much the spread of the covariate understates what a guess of the rest may be off.
    """

    deviation: float
    known: float
    inflation: float


class LagFilter:
    """The same, period by period: what acts of one covariate now.

    means: number of a period -> mean, which others fill. center, hold, lag: as above.
    """

    def __init__(self, means: Mapping[int, float], center: float, hold: int, lag: Lag) -> None:
        self._means, self._center, self._hold, self._lag = means, center, hold, lag
        self._kept = lag.kept
        self._period: int | None = None
        self._begin()

    def at(self, period: int) -> Lagged:
        """Return what acts in a period; an earlier one than before is as the newest."""
        if self._period is None or period - self._period > MOST_GAP:
            self._begin()
            early = [number for number in self._means if period - MOST_GAP < number <= period]
            self._period = min(early, default=period) - 1
        while self._period < period:
            self._period += 1
            self._step(self._period - self._lag.periods)
        return Lagged(self._lagged, self._known, sqrt(1.0 + self._missing / DRIFTS))

    def _begin(self) -> None:
        """Begin with nothing known."""
        self._now, self._recent = 0.0, 0.0
        self._lagged, self._known = 0.0, 0.0
        self._missing = UNREAD

    def _step(self, number: int) -> None:
        mean = self._means.get(number)
        self._missing += 1
        if mean is not None:
            self._now = mean - self._center
            if self._missing > UNREAD:  # the first: all before it was as it is
                self._recent = self._lagged = self._now
            self._missing = 0
        there = self._missing <= self._hold
        if there:
            self._recent += (self._now - self._recent) / RECENT
        self._lagged += (1.0 - self._kept) * ((self._now if there else self._recent) - self._lagged)
        self._known = self._kept * self._known + (1.0 - self._kept) * there
