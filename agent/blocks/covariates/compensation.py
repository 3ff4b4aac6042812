"""References that move with covariates: rows are cut where they change, each with the one of its instant."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from math import ceil
from typing import NamedTuple

import numpy as np

from agent.records import Baseline, HealthEvent
from agent.reference.covariates.dependence import Dependence, read, remark, shift, stepped, widened
from agent.reference.covariates.lags import PERIOD_S, LagFilter, newest_period
from agent.reference.tuning import STEPS_A_SPREAD
from agent.types import EstimateBatch

SOURCE, UNSURE, SURE = "baseline", "covariate", "recovered"
"""What events of references that are less well known, and of those that are again, are called."""


def dependences(one: Baseline) -> tuple[Dependence, ...]:
    """Return what a baseline's reference depends on; nothing where that cannot be read."""
    try:
        return tuple(dependence for dependence in read(one.covariates) if dependence.used)
    except (ValueError, KeyError, TypeError):
        return ()


class Origin(NamedTuple):
    """What changes are counted from in a period: reference, its sd, and why that is wider than learnt."""

    reference: float
    sd: float
    remark: str


@dataclass(slots=True)
class _Moved:
    """One parameter whose reference moves."""

    baseline: Baseline
    found: tuple[Dependence, ...]
    filters: Mapping[str, LagFilter]

    def at(self, period: int) -> Origin:
        """Return what changes are counted from in a period."""
        lagged = {name: lag_filter.at(period) for name, lag_filter in self.filters.items()}
        moved, moved_sd = shift(lagged, self.found)
        reference = stepped(self.baseline.reference, moved, self.baseline.spread_sd / STEPS_A_SPREAD)
        said = [words for one in self.found if (words := remark(one, lagged[one.name]))]
        return Origin(reference, widened(self.baseline.sd, moved_sd), "; ".join(said))


class Compensation:
    """The references of one rig's rows, moved by what the machine feels of its covariates.

    rig: its name. means: number of a period -> mean, of each covariate.
    """

    def __init__(self, rig: str, means: Mapping[str, Mapping[int, float]]) -> None:
        self._rig, self._means = rig, means
        self._moved: dict[str, _Moved] = {}
        self._said: dict[str, str] = {}

    def count_from(self, baselines: Sequence[Baseline]) -> None:
        """Move these references from the next row on, those of them that depend on a covariate."""
        self._moved = {
            one.parameter: self._of(one, found) for one in baselines if (found := dependences(one))
        }

    def _of(self, one: Baseline, found: tuple[Dependence, ...]) -> _Moved:
        filters = {
            d.name: LagFilter(self._means.get(d.name, {}), d.center, ceil(d.hold_s / PERIOD_S), d.lag)
            for d in found
        }
        return _Moved(one, found, filters)

    def step(self, batch: EstimateBatch) -> tuple[list[EstimateBatch], list[HealthEvent]]:
        """Return rows with the references that hold at their instants, and what is newly said of these."""
        if not self._moved or not len(batch):
            return [batch], []
        parts: list[EstimateBatch] = []
        events: list[HealthEvent] = []
        for rows, origins in self._stretches(batch):
            part = _counted(batch.part(rows), origins)
            parts.append(part)
            events += self._news(origins, int(part.t_ns[0]))
        return parts, events

    def _stretches(self, batch: EstimateBatch) -> Iterator[tuple[slice, Mapping[str, Origin]]]:
        """Yield consecutive rows of one reference each."""
        periods = newest_period(batch.t_ns)
        starts = np.flatnonzero(np.r_[True, np.diff(periods) != 0]).tolist()
        of_start = [(start, self._at(int(periods[start]))) for start in starts]
        stops: list[tuple[int, Mapping[str, Origin]]] = []
        for origins, members in groupby(of_start, key=lambda pair: pair[1]):
            stops.append((next(iter(members))[0], origins))
        for (start, origins), (stop, _) in zip(stops, [*stops[1:], (len(batch), {})], strict=True):
            yield slice(start, stop), origins

    def _at(self, period: int) -> Mapping[str, Origin]:
        return {name: moved.at(period) for name, moved in self._moved.items()}

    def _news(self, origins: Mapping[str, Origin], t_ns: int) -> Iterator[HealthEvent]:
        """Yield an event where it begins or ends that a reference is less well known than it was learnt."""
        for name, origin in origins.items():
            if origin.remark == self._said.get(name, ""):
                continue
            self._said[name] = origin.remark
            if origin.remark:
                words = f"the reference of {name} is known to {origin.sd:.2g} only: {origin.remark}"
            else:
                words = f"the reference of {name} is known as well as it was learnt again"
            yield HealthEvent(self._rig, SOURCE, t_ns, UNSURE if origin.remark else SURE, words)


def _counted(batch: EstimateBatch, origins: Mapping[str, Origin]) -> EstimateBatch:
    """Return rows that count from these references."""
    reference = batch.reference.copy()
    sd = list(batch.reference_sd or [np.nan] * len(reference))
    remarks = [""] * len(reference)
    for column, name in enumerate(batch.parameters):
        if name in origins:
            reference[column], sd[column], remarks[column] = origins[name]
    said = tuple(remarks) if any(remarks) else None
    others = tuple(replace(other, reference=reference, reference_sd=tuple(sd)) for other in batch.others)
    return replace(batch, reference=reference, reference_sd=tuple(sd), remarks=said, others=others)
