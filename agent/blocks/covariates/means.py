"""Means of covariates over minutes, from readings that come at any rate and from any source."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agent.blocks.tuning import MEMORY_PERIODS
from agent.config.sections.covariates import Covariate
from agent.records import CovariateMean
from agent.reference.tuning import CLOSED
from agent.types import FloatArray, IntArray
from agent.units import MINUTE_NS


@dataclass(slots=True)
class _Sum:
    total: float = 0.0
    n: int = 0


class CovariateMeans:
    """What the covariates of one rig were, period by period.

    rig: its name. covariates: those of its configuration.

    Attributes:
        known: number of a period -> mean, of each covariate; what earlier runs stored is in it too.
    """

    def __init__(self, rig: str, covariates: Sequence[Covariate]) -> None:
        self._rig = rig
        self._covariates = {one.name: one for one in covariates}
        self.known: dict[str, dict[int, float]] = {one.name: {} for one in covariates}
        self._open: dict[str, dict[int, _Sum]] = {one.name: {} for one in covariates}
        self._closed: int | None = None

    def adopt(self, means: Iterable[CovariateMean]) -> None:
        """Begin with what earlier runs stored; of an hour every period in it is as its mean."""
        for mean in means:
            table = self.known.get(mean.name)
            if table is not None and mean.unit == self._covariates[mean.name].unit:
                first = mean.t_ns // MINUTE_NS
                table.update(
                    dict.fromkeys(range(first, first + mean.span_s * 10**9 // MINUTE_NS), mean.value)
                )

    def take(self, t_ns: IntArray, readings: Mapping[str, FloatArray]) -> None:
        """Take readings (n,) of covariates at instants t_ns (n,); NaN where there is none."""
        periods = t_ns // MINUTE_NS
        for name, raw in readings.items():
            one = self._covariates[name]
            value = raw * one.scale + one.offset
            there = np.isfinite(value)
            self._add(name, periods[there], value[there])

    def _add(self, name: str, periods: IntArray, value: FloatArray) -> None:
        """Add readings to their periods; those of a period that rows already rest on come too late."""
        table, known = self._open[name], self.known[name]
        numbers, place = np.unique(periods, return_inverse=True)
        totals, counts = np.bincount(place, value, len(numbers)), np.bincount(place, minlength=len(numbers))
        for period, total, n in zip(numbers.tolist(), totals.tolist(), counts.tolist(), strict=True):
            if self._closed is not None and period <= self._closed:
                continue
            so_far = table.setdefault(period, _Sum())
            so_far.total += total
            so_far.n += n
            known[period] = so_far.total / so_far.n

    def close(self, period: int) -> list[CovariateMean]:
        """Return the means of the periods up to this one that were not returned yet, in order of time."""
        if self._closed is not None and period <= self._closed:
            return []
        self._closed = period
        found = [mean for name in self._open for mean in self._ended(name, period)]
        for table in self.known.values():
            for old in [number for number in table if number < period - MEMORY_PERIODS]:
                del table[old]
        return sorted(found, key=lambda mean: mean.t_ns)

    def _ended(self, name: str, period: int) -> list[CovariateMean]:
        table = self._open[name]
        ended = sorted(number for number in table if number <= period)
        unit = self._covariates[name].unit
        sums = [(number, table.pop(number)) for number in ended]
        return [CovariateMean(self._rig, name, unit, n * MINUTE_NS, s.total / s.n, s.n) for n, s in sums]

    def step(self, t_ns: int) -> list[CovariateMean]:
        """Return the means that rows at an instant rest on, once each."""
        return self.close(t_ns // MINUTE_NS - CLOSED)

    def finish(self) -> list[CovariateMean]:
        """Return the means of all periods that have readings."""
        newest = max((number for table in self._open.values() for number in table), default=None)
        return [] if newest is None else self.close(newest)
