"""Which sample is it: counters unwrapped, time stamps rounded to indices, repeats and steps back refused."""

from collections import Counter
from dataclasses import dataclass, field
from math import gcd
from typing import Literal, NamedTuple

import numpy as np

from agent.blocks.acquisition.arrival_count import ArrivalCount
from agent.blocks.tuning import JOIN_S, LEAK, PUNCTUAL_S, RESTART_AFTER_S, WIDEST
from agent.numerics.preprocessing.rows import steps_from
from agent.types import BoolArray, IntArray
from drivers.port import SampleBlock

Clock = Literal["counter", "device", "uniform", "arrival"]


class Anew(NamedTuple):
    """Where the first source to count anew stood: a sample's number and counter, and where that wraps."""

    number: int
    raw: int
    modulus: int | None


@dataclass(slots=True)
class Origin:
    """Counter value or time stamp of index 0; shared by the sources of a rig, set by the first sample of any.

    Attributes:
        shared: several sources count from here, so that one whose count leaps must not part from the others.
        generation: how often a source began to count anew and was not joined to one that had.
        anew: where the source stands that was the last to do so.
    """

    value: int | None = None
    shared: bool = False
    generation: int = 0
    anew: Anew | None = None

    def renumber(
        self, generation: int, by_time: int, raw: int, modulus: int | None, reach: float
    ) -> tuple[int, int]:
        """Return the index of a sample of a source that counts anew, and the generation of its numbers.

        Another source that began anew since this one did (`generation`) gives the number where both counts
        agree with the clock, `by_time`, to within `reach` samples, and wraps are too far apart for that to be
        chance.
        """
        other = self.anew if self.generation > generation else None
        joined = None if other is None else _joined(other, by_time, raw, modulus, reach)
        if joined is not None:
            return joined, self.generation
        self.generation += 1
        self.anew = Anew(by_time, raw, modulus)
        return by_time, self.generation


def _joined(other: Anew, by_time: int, raw: int, modulus: int | None, reach: float) -> int | None:
    """Return a sample's index by the count of another source that began anew; None if that may be chance."""
    wrap = gcd(other.modulus or 0, modulus or 0)
    count = other.number + raw - other.raw
    if wrap:
        count += wrap * round((by_time - count) / wrap)
    if 0 < wrap < 4 * reach:
        return None
    return count if abs(count - by_time) <= reach else None


@dataclass(slots=True)
class Indexer:
    """Gives each sample of one source its index since the run's first sample.

    Attributes:
        clock: what orders samples; "counter" falls back to time stamps where a block has no counter.
        rate_hz: nominal sampling rate.
        origin: where index 0 lies.
        modulus: the counter wraps at this; None where it does not.
        rejected: samples refused, by reason.
        restarts: how often the device was found to have started anew.
        generation: of the origin that its numbers count from; sources of one origin and generation count
            together.
        began: index of the first sample of the count that it follows now.
    """

    clock: Clock
    rate_hz: float
    origin: Origin = field(default_factory=Origin)
    modulus: int | None = None
    rejected: Counter[str] = field(default_factory=Counter)
    restarts: int = 0
    generation: int = 0
    began: int = 0
    _resumed: int = -1  # index of the newest sample when the count began anew
    _newest: int = -1  # newest accepted index
    _last: int | None = None  # an index ...
    _raw: int = 0  # ... its counter value or time stamp ...
    _received_ns: int = 0  # ... and its arrival
    _behind: int = 0
    _epoch: int = 0
    _line_ns: float | None = None  # arrival of index 0, had it been as punctual as the most punctual sample
    _arrivals: ArrivalCount | None = None

    def take(self, block: SampleBlock) -> tuple[IntArray, BoolArray]:
        """Return the indices of a block's samples (n,) and which go forward (n,); count the others."""
        if not len(block):
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        counted = self.clock == "counter" and block.counter is not None
        if self.clock == "arrival" and block.t_ns is None:
            return self._by_arrival(block)
        stamped = self.clock != "uniform" and block.t_ns is not None
        return self._by_readings(block, counted=counted, numbered=not counted and not stamped)

    def _by_readings(
        self, block: SampleBlock, *, counted: bool, numbered: bool
    ) -> tuple[IntArray, BoolArray]:
        """Number samples by their counter, by their time stamps, or one after the other."""
        arrival_ns = block.arrival_ns
        raw = self._readings(block, counted=counted, numbered=numbered)
        began_anew = block.epoch != self._epoch and self._last is not None
        if began_anew and not numbered:
            self._begin_anew(raw, arrival_ns, counted=counted)
        self._epoch = block.epoch
        index = raw if numbered else self._from_raw(raw, arrival_ns, counted=counted)
        kept = self._forward(index)
        if kept.any():
            newest = int(np.flatnonzero(kept)[-1])
            self._newest = self._last = int(index[newest])
            self._raw = int(raw[newest])
            self._received_ns = arrival_ns
            self._line_ns = self._punctual_ns(arrival_ns)
        elif self._behind > RESTART_AFTER_S * self.rate_hz:
            self._give_up(raw, arrival_ns, counted=counted)
        return index, kept

    def _begin_anew(self, raw: IntArray, arrival_ns: int, *, counted: bool) -> None:
        """Go on where the block says that its device began anew."""
        if counted:
            self._count_anew(raw, arrival_ns)
        else:
            # the first sample of a device that began anew comes after the time that passed
            self._stamp_anew(int(raw[0]) - 1, arrival_ns)

    def _give_up(self, raw: IntArray, arrival_ns: int, *, counted: bool) -> None:
        """Go on with a count that has run backwards for so long that its device must have begun anew."""
        if counted:
            self._count_anew(raw[-1:], arrival_ns)
            self._newest = max(self._newest, self._resumed)
        else:
            self._stamp_anew(int(raw[-1]), arrival_ns)

    def _from_raw(self, raw: IntArray, arrival_ns: int, *, counted: bool) -> IntArray:
        return self._from_counter(raw, arrival_ns) if counted else self._from_time(raw)

    def _by_arrival(self, block: SampleBlock) -> tuple[IntArray, BoolArray]:
        """Number samples that nothing but their arrival orders."""
        if self._arrivals is None:
            self._arrivals = ArrivalCount(self.rate_hz)
        index, self.origin.value = self._arrivals.take(block, self.origin.value)
        kept = self._forward(index)
        if kept.any():
            self._newest = self._last = int(index[kept][-1])
            self._received_ns = block.arrival_ns
        return index, kept

    def _readings(self, block: SampleBlock, *, counted: bool, numbered: bool) -> IntArray:
        """What says the order: counter values, row numbers, or time stamps."""
        if counted and block.counter is not None:
            return block.counter
        if numbered or block.t_ns is None:
            return (0 if self._last is None else self._last + 1) + np.arange(len(block), dtype=np.int64)
        return block.t_ns

    def _from_time(self, raw: IntArray) -> IntArray:
        if self.origin.value is None:
            self.origin.value = int(raw[0])
        since = (raw - self.origin.value).astype(np.longdouble)
        return np.asarray(np.rint(since * (self.rate_hz / 1e9)), dtype=np.int64)

    def _from_counter(self, raw: IntArray, arrival_ns: int) -> IntArray:
        if self.origin.value is None:
            self.origin.value = int(raw[0])
        if self._last is None:
            steps = steps_from(self.origin.value, raw)
            return np.cumsum(self._shortest(steps))
        steps = self._shortest(steps_from(self._raw, raw))
        steps[0] += self._silent_wraps(int(steps.sum()), arrival_ns)
        index = self._last + np.cumsum(steps)
        leap = int(np.argmax(steps))
        if self.origin.shared and steps[leap] > 1 and self._ahead(int(index[-1]), arrival_ns):
            self._count_anew(raw[leap:], arrival_ns)
            index[leap:] += self._resumed - index[-1]
        return index

    def _punctual_ns(self, arrival_ns: int) -> float:
        """When index 0 would have arrived, had it been as punctual as the most punctual sample was."""
        here = arrival_ns - self._newest * 1e9 / self.rate_hz
        return (
            here
            if self._line_ns is None
            else min(here, self._line_ns + LEAK * (arrival_ns - self._received_ns))
        )

    def _ahead(self, index: int, arrival_ns: int) -> bool:
        """Tell whether a sample would have come before its time: its device counts anew, from further on."""
        if self._line_ns is None:
            return False
        due_ns = self._line_ns + LEAK * (arrival_ns - self._received_ns) + index * 1e9 / self.rate_hz
        return due_ns - arrival_ns > PUNCTUAL_S * 1e9

    def _shortest(self, steps: IntArray) -> IntArray:
        if self.modulus is None or self.modulus > WIDEST:
            return steps
        half = self.modulus // 2
        return np.asarray((steps + half) % self.modulus - half)

    def _silent_wraps(self, counted: int, arrival_ns: int) -> int:
        """Samples that whole wraps of the counter hide, after a silence longer than half a wrap.

        counted: the samples up to the newest, by the counter alone. A long block is no silence before its
        first one.
        """
        hidden = (arrival_ns - self._received_ns) * self.rate_hz / 1e9 - counted
        if self.modulus is None or hidden < max(self.modulus / 2, PUNCTUAL_S * self.rate_hz):
            return 0
        return self.modulus * round(hidden / self.modulus)

    def _forward(self, index: IntArray) -> BoolArray:
        newest = np.maximum.accumulate(np.concatenate([[np.int64(self._newest)], index]))[:-1]
        kept = np.asarray(index > newest)
        if kept.all():
            self._behind = 0
            return kept
        repeated = ~kept & (index == newest)
        backwards = int((~kept & ~repeated).sum())
        self.rejected.update({"duplicate": int(repeated.sum()), "backwards": backwards})
        self._behind = 0 if kept.any() else self._behind + backwards
        return kept

    def _elapsed(self, arrival_ns: int) -> int:
        """Samples since the newest one by the monotonic clock; one at least."""
        return max(1, round((arrival_ns - self._received_ns) * self.rate_hz / 1e9))

    def _count_anew(self, raw: IntArray, arrival_ns: int) -> None:
        """Go on with a new count, whose counters (n,) have just come: by time, or with a source that did too.

        The newest of them is as old as the newest of any block, whatever came before it.
        """
        by_time = self._newest + self._elapsed(arrival_ns)
        if self._line_ns is not None:
            # the newest sample before may have been old when it came: its device was on its way down
            by_time = max(self._newest + 1, round((arrival_ns - self._line_ns) * self.rate_hz / 1e9))
        known = self.origin.renumber(
            self.generation, by_time, int(raw[-1]), self.modulus, JOIN_S * self.rate_hz
        )
        self._resumed, self.generation = known
        self._raw = int(raw[0])
        self._received_ns = arrival_ns
        self._behind = 0
        self._last = self.began = self._resumed - int(self._shortest(np.diff(raw)).sum())
        self._line_ns = None
        self.restarts += 1

    def _stamp_anew(self, raw: int, arrival_ns: int) -> None:
        """Go on after the time that passed on the monotonic clock, with the device's new time stamps."""
        self._newest = self._last = self.began = self._newest + self._elapsed(arrival_ns)
        self._raw, self._received_ns, self._behind = raw, arrival_ns, 0
        self.restarts += 1
        self.origin.value = raw - round(self._last * 1e9 / self.rate_hz)
