"""When which parameter takes which value: steps and ramps, exact to the sample.

A change at T governs the motion from T on: with T at sample i, the interval from i to i + 1 is the first with
the new value; a T between two samples takes effect at the later one.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from pydantic import Field

from sim_bus.tables import Table

Values = Mapping[str, float]


class Change(Table):
    """One [[change]]: from `at_s` on the named parameters move to nominal + delta, value or nominal·(1 + %).

    With ramp_s > 0 they go there linearly, in steps of `every_s`.
    """

    at_s: float = Field(ge=0)
    delta: dict[str, float] = Field(default_factory=dict)
    value: dict[str, float] = Field(default_factory=dict)
    percent: dict[str, float] = Field(default_factory=dict)
    ramp_s: float = Field(default=0.0, ge=0)
    every_s: float = Field(default=0.01, gt=0)

    def targets(self, nominal: Values) -> dict[str, float]:
        """Return where each named parameter that there is goes."""
        goes = {name: nominal[name] + delta for name, delta in self.delta.items() if name in nominal}
        goes |= self.value
        return goes | {
            n: nominal[n] * (1.0 + percent / 100.0) for n, percent in self.percent.items() if n in nominal
        }

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that it moves."""
        return (*self.delta, *self.value, *self.percent)


class Draw(Table):
    """[draw]: a random schedule.

    In each of `segments` stretches of `segment_s`, each parameter of `delta` keeps its nominal value with
    probability `keep`, else moves by a number drawn evenly from one of its intervals.
    """

    segments: int = Field(default=3, ge=1)
    segment_s: float = Field(default=1.0, gt=0)
    keep: float = Field(default=0.5, ge=0, le=1)
    delta: dict[str, list[tuple[float, float]]]

    def changes(self, seed: int) -> list[Change]:
        """Return the schedule that belongs to the seed."""
        rng = np.random.default_rng([seed, 2])
        return [
            Change(at_s=number * self.segment_s, delta=self._deltas(rng)) for number in range(self.segments)
        ]

    def _deltas(self, rng: np.random.Generator) -> dict[str, float]:
        moved: dict[str, float] = {}
        for name, intervals in self.delta.items():
            low, high = intervals[int(rng.integers(len(intervals)))]
            drawn = round(float(rng.uniform(low, high)), 3)
            moved[name] = 0.0 if rng.random() < self.keep else drawn
        return moved


class Path(Protocol):
    """What moves parameters besides a schedule."""

    def offset(self, name: str, index: int) -> float: ...
    def next_after(self, index: int) -> int | None: ...


@dataclass(frozen=True, slots=True)
class _Move:
    """A parameter's way from sample `start`: to `target` in `ramp` samples, moving every `every` samples."""

    start: int
    ramp: int
    every: int
    origin: float
    target: float

    def at(self, index: int) -> float:
        if index >= self.start + self.ramp:
            return self.target
        done = (index - self.start) // self.every * self.every
        return self.origin + (self.target - self.origin) * done / self.ramp

    def next_after(self, index: int) -> int | None:
        """Return the next sample after `index` at which the value moves."""
        if index >= self.start + self.ramp:
            return None
        later = self.start + ((index - self.start) // self.every + 1) * self.every
        return min(later, self.start + self.ramp)


class Timeline:
    """Every parameter's value at every sample.

    Args:
        nominal: every parameter's value before any change.
        wear: what moves them besides.
        changes: the schedule; of two changes of one parameter at one time the later in the list wins.
        sample_rate_hz: samples a second.
    """

    def __init__(
        self, nominal: Values, changes: Sequence[Change], sample_rate_hz: float, wear: Sequence[Path] = ()
    ) -> None:
        self.names = tuple(nominal)
        self._wear = tuple(wear)
        self._rate = sample_rate_hz
        self._moves: dict[str, list[_Move]] = {
            name: [_Move(0, 0, 1, value, value)] for name, value in nominal.items()
        }
        for change in sorted(changes, key=lambda change: change.at_s):
            self._add(change, nominal)

    def _add(self, change: Change, nominal: Values) -> None:
        start = first_sample(change.at_s, self._rate)
        ramp = round(change.ramp_s * self._rate)
        every = max(1, round(change.every_s * self._rate))
        for name, target in change.targets(nominal).items():
            self._moves[name].append(_Move(start, ramp, every, self._value(name, start), target))

    def _move(self, name: str, index: int) -> _Move:
        return next(move for move in reversed(self._moves[name]) if move.start <= index)

    def _value(self, name: str, index: int) -> float:
        return self._move(name, index).at(index)

    def values(self, index: int) -> dict[str, float]:
        """Return the values that govern the interval from sample `index` to the next."""
        return {
            name: self._value(name, index) + math.fsum(path.offset(name, index) for path in self._wear)
            for name in self.names
        }

    def summary(self, end: int) -> list[dict[str, str | int | float]]:
        """Return every change before sample `end`: parameter, first sample, samples it takes, from, to."""
        return [
            {
                "parameter": name,
                "sample": move.start,
                "ramp": move.ramp,
                "from": move.origin,
                "to": move.target,
            }
            for name, moves in self._moves.items()
            for move in moves[1:]
            if move.start < end and move.origin != move.target
        ]

    def _next_move(self, index: int, stop: int) -> int:
        later = [
            stop,
            *(move.start for moves in self._moves.values() for move in moves if move.start > index),
        ]
        later += [after for path in self._wear if (after := path.next_after(index)) is not None]
        later += [
            after for name in self.names if (after := self._move(name, index).next_after(index)) is not None
        ]
        return min(later)

    def segments(self, start: int, stop: int) -> Iterator[tuple[int, int, dict[str, float]]]:
        """Yield (first, end, values): runs of intervals first .. end − 1 that share their parameters."""
        while start < stop:
            end = self._next_move(start, stop)
            yield start, end, self.values(start)
            start = end


def first_sample(t_s: float, sample_rate_hz: float) -> int:
    """Return the first sample at or after t_s (to a thousandth of a sample)."""
    return math.ceil(t_s * sample_rate_hz - 1e-3)
