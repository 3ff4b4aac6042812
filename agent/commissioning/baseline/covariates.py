"""Covariates of a healthy stretch: what was read, what they still have to show, what parameters depend on."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from agent.commissioning.baseline.target import Target
from agent.commissioning.tuning import EDGES, HELD_TIMES, PRESENT
from agent.config.sections.covariates import BaselineTable
from agent.errors import Fault
from agent.reference.covariates.dependence import Dependence
from agent.reference.covariates.lags import PERIOD_S, Lag, Series, newest_period, series
from agent.reference.covariates.regression import Found, alike, regress
from agent.reference.spread import grouping
from agent.storage.read import covariates as stored
from agent.storage.read.covariates import Means
from agent.storage.read.points import Points
from agent.text import number, percent
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Ready:
    """One covariate of a stretch.

    Attributes:
        name, unit: of the covariate. center, spread: mean and sd of what was read. hold: periods a reading
            stands for.
        grid: it on the grid of minutes. edges: (c + 1,) of the classes that the machine is to have run in.
    """

    name: str
    unit: str
    center: float
    spread: float
    hold: int
    grid: Series
    edges: FloatArray
    _lagged: dict[Lag, FloatArray] = field(default_factory=dict)

    def lagged(self, lag: Lag, t_ns: IntArray) -> FloatArray:
        """Return what acts of it at rows (n,), from its centre."""
        if lag not in self._lagged:
            self._lagged[lag] = self.grid.lagged(lag)
        return np.asarray(self._lagged[lag][self._places(t_ns)])

    def covered(self, t_ns: IntArray) -> BoolArray:
        """Return at which rows (n,) it is known."""
        inside = (newest_period(t_ns) >= self.grid.first) & (
            newest_period(t_ns) < self.grid.first + self._length
        )
        return np.asarray(inside & self.grid.covered[self._places(t_ns)])

    @property
    def _length(self) -> int:
        return len(self.grid.deviation)

    def _places(self, t_ns: IntArray) -> IntArray:
        return np.clip(newest_period(t_ns) - self.grid.first, 0, self._length - 1)


def read(
    target: Target, table: BaselineTable, first_ns: int, last_ns: int
) -> tuple[list[Ready], list[Fault]]:
    """Return the covariates of a stretch, and why some of them teach nothing. Raises StoreError."""
    known = stored.means(target.db, target.rig)
    configured = {one.name: one.range for one in target.config.covariate} if target.config is not None else {}
    asked = tuple(configured or known) if table.covariates is None else table.covariates
    ready: list[Ready] = []
    faults: list[Fault] = []
    for name in asked:
        found = known.get(name, _NOTHING)
        own = found.value[_within(found, first_ns, last_ns)]
        if (fault := _useless(name, own, found.unit)) is not None:
            faults.append(fault)
            continue
        low, high = configured.get(name) or np.quantile(found.value, EDGES).tolist()
        ready.append(_ready(name, found, own, np.linspace(low, high, table.classes + 1)))
    return ready, faults


_LEAVE = "leave {0} out of [baseline] covariates"
_NOTHING = Means("", {})


def _useless(name: str, own: FloatArray, unit: str) -> Fault | None:
    """Return why what was read of a covariate teaches nothing; None where it may."""
    if not len(own):
        return Fault(name, f"{name} was not read in this stretch", _LEAVE.format(name))
    if np.ptp(own) <= 1e-9 * np.abs(own).max():
        what = f"{name} never moved in this stretch: it is {number(float(own[0]))} {unit} throughout"
        return Fault(name, what, f"learn when it has, or: {_LEAVE.format(name)}")
    return None


def _within(found: Means, first_ns: int, last_ns: int) -> BoolArray:
    first, last = newest_period(np.array([first_ns, last_ns]))
    return np.asarray((found.number >= first) & (found.number <= last))


def _ready(name: str, found: Means, own: FloatArray, edges: FloatArray) -> Ready:
    center = float(own.mean())
    step = float(np.median(np.diff(found.number))) if len(found.number) > 1 else 1.0
    hold = max(HELD_TIMES, ceil(HELD_TIMES * step))
    grid = series(found.number, found.value, center, hold)
    return Ready(name, found.unit, center, float(own.std()), hold, grid, edges)


def unready(points: Points, period_s: float, ready: Sequence[Ready], least: int) -> Iterator[Fault]:
    """Yield what covariates still have to show where a parameter has valid rows."""
    groups = grouping(points.t_ns / 1e9, points.value, period_s)
    for one in ready:
        covered = one.covered(points.t_ns)
        there = groups.means(covered.astype(np.float64)) > PRESENT
        have = int(there.sum())
        wanted = len(there)
        unit, each = ("hours", period_s / 3600.0) if period_s >= 3600.0 else ("s", period_s)
        if have < least or have < PRESENT * wanted:
            shown = f"{number(each * (wanted - have), 3)} of {number(each * wanted, 3)} {unit}"
            what = f"{one.name} is missing in {shown} in which {points.parameter} has valid rows"
            yield Fault(one.name, what, f"see its source in v_health, or: {_LEAVE.format(one.name)}")
            continue
        yield from _classes(one, groups.means(one.lagged(Lag(), points.t_ns))[there] + one.center)


def _classes(one: Ready, value: FloatArray) -> Iterator[Fault]:
    wanted = len(one.edges) - 1
    inside = np.clip(np.searchsorted(one.edges, value, side="right") - 1, 0, wanted - 1)
    run = np.unique(inside)
    if len(run) < wanted:
        lacks = [f"{number(one.edges[k], 3)} to {number(one.edges[k + 1], 3)}"
                 for k in range(wanted) if k not in run]  # fmt: skip
        what = f"not yet: the machine has run in {len(run)} of {wanted} {one.name} classes"
        what += f" ({percent(len(run) / wanted)}); not in {', '.join(lacks)} {one.unit}"
        yield Fault(
            one.name, what, "let it run on, or ask for less: [baseline] classes, or range of the channel"
        )


def known_rows(points: Points, ready: Sequence[Ready]) -> BoolArray:
    """Return which rows (n,) of a parameter all covariates are known at."""
    covered = [one.covered(points.t_ns) for one in ready]
    return np.logical_and.reduce(covered) if covered else np.ones(len(points.t_ns), dtype=np.bool_)


def same(points: Points, ready: Sequence[Ready]) -> Fault | None:
    """Return why two covariates cannot be told apart; None where they can."""
    found = alike(np.column_stack([one.lagged(Lag(), points.t_ns) for one in ready])) if ready else None
    if found is None:
        return None
    first, second = (ready[place].name for place in found)
    what = f"{first} and {second} move together: which of them {points.parameter} depends on cannot be known"
    return Fault(second, what, _LEAVE.format(f"{first} or {second}"))


def depends(t_ns: IntArray, value: FloatArray, period_s: float, ready: Sequence[Ready]) -> list[Dependence]:
    """Return what rows t_ns (n,), value (n,) depend on."""
    if not ready:
        return []
    groups = grouping(t_ns / 1e9, value, period_s)
    kept: dict[tuple[int, Lag], FloatArray] = {}

    def columns(place: int, lag: Lag) -> FloatArray:
        if (place, lag) not in kept:
            kept[place, lag] = groups.means(ready[place].lagged(lag, t_ns))
        return kept[place, lag]

    span_s = float(t_ns[-1] - t_ns[0]) / 1e9
    found = regress(groups.means(value), groups.number, columns, len(ready), span_s)
    pairs = zip(ready, found, strict=True)
    return [_dependence(one, was, columns(place, was.lag)) for place, (one, was) in enumerate(pairs)]


def _dependence(one: Ready, was: Found, lagged: FloatArray) -> Dependence:
    low, high = np.quantile(lagged, EDGES) + one.center
    return Dependence(
        one.name, one.unit, was.coefficient, was.sd, was.coefficient - 1.96 * was.sd,
        was.coefficient + 1.96 * was.sd,
        was.lag.shape, was.lag.seconds, was.lag_lower_s, was.lag_upper_s, one.center, float(low), float(high),
        one.spread, one.hold * PERIOD_S, was.significant,
    )  # fmt: skip


def taken_out(
    t_ns: IntArray, value: FloatArray, found: Sequence[Dependence], ready: Mapping[str, Ready]
) -> FloatArray:
    """Return rows as they would be with every covariate at its centre."""
    moved = [one.coefficient * ready[one.name].lagged(one.lag, t_ns) for one in found if one.used]
    return value - sum(moved) if moved else value
