"""Which sample is it: counters unwrapped and time stamps rounded to indices, repeats and steps back refused."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent.blocks.arrival_count import ArrivalCount
from agent.types import IntArray
from drivers.port import SampleBlock

Clock = Literal["counter", "device", "uniform", "arrival"]
BoolArray = NDArray[np.bool_]
WIDEST = 1 << 62
"""A counter of more values does not wrap in any lifetime, and one of 64 bits wraps with the numbers themselves."""
RESTART_AFTER_S = 0.1
"""A device that keeps counting from behind for this long has restarted; a single late frame has not."""


PUNCTUAL_S = 0.1
"""Samples that are late by less may only have been read late: a clock that says so tells of no silence."""


@dataclass(slots=True)
class Origin:
    """Counter value or time stamp of index 0; shared by the sources of one rig, set by the first sample of any."""

    value: int | None = None


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
    """

    clock: Clock
    rate_hz: float
    origin: Origin = field(default_factory=Origin)
    modulus: int | None = None
    rejected: Counter[str] = field(default_factory=Counter)
    restarts: int = 0
    _last: int | None = None  # newest accepted index ...
    _raw: int = 0  # ... its counter value or time stamp ...
    _heard_ns: int = 0  # ... and its arrival
    _behind: int = 0
    _epoch: int = 0
    _arrivals: ArrivalCount | None = None

    def take(self, block: SampleBlock) -> tuple[IntArray, BoolArray]:
        """Return the indices of a block's samples (n,) and which of them go forward (n,); count the others."""
        rows, arrival_ns = len(block), block.arrival_ns
        if not rows:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
        counted = self.clock == "counter" and block.counter is not None
        if self.clock == "arrival" and block.t_ns is None:
            return self._by_arrival(block)
        numbered = not counted and (self.clock == "uniform" or block.t_ns is None)
        raw = self._readings(block, counted=counted, numbered=numbered)
        if block.epoch != self._epoch and self._last is not None and not numbered:
            # the first sample of a device that began anew comes after the time that passed
            self._start_anew(int(raw[0]) - 1, counted, arrival_ns)
        self._epoch = block.epoch
        index = raw if numbered else self._from_counter(raw, arrival_ns) if counted else self._from_time(raw)
        kept = self._forward(index)
        if kept.any():
            newest = int(np.flatnonzero(kept)[-1])
            self._last, self._raw, self._heard_ns = int(index[newest]), int(raw[newest]), arrival_ns
        elif self._behind > RESTART_AFTER_S * self.rate_hz:
            self._start_anew(int(raw[-1]), counted, arrival_ns)
        return index, kept

    def _by_arrival(self, block: SampleBlock) -> tuple[IntArray, BoolArray]:
        """Number samples that nothing but their arrival orders."""
        if self._arrivals is None:
            self._arrivals = ArrivalCount(self.rate_hz)
        index, self.origin.value = self._arrivals.take(block, self.origin.value)
        kept = self._forward(index)
        if kept.any():
            self._last, self._heard_ns = int(index[kept][-1]), block.arrival_ns
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
            steps = np.diff(raw, prepend=np.int64(self.origin.value))
            return np.cumsum(self._shortest(steps))
        steps = self._shortest(np.diff(raw, prepend=np.int64(self._raw)))
        steps[0] += self._silent_wraps(int(steps.sum()), arrival_ns)
        return self._last + np.cumsum(steps)

    def _shortest(self, steps: IntArray) -> IntArray:
        if self.modulus is None or self.modulus > WIDEST:
            return steps
        half = self.modulus // 2
        return np.asarray((steps + half) % self.modulus - half)

    def _silent_wraps(self, counted: int, arrival_ns: int) -> int:
        """Samples that whole wraps of the counter hide, after a silence longer than half a wrap.

        counted: the samples up to the newest, by the counter alone. A long block is no silence before its first one.
        """
        hidden = (arrival_ns - self._heard_ns) * self.rate_hz / 1e9 - counted
        if self.modulus is None or hidden < max(self.modulus / 2, PUNCTUAL_S * self.rate_hz):
            return 0
        return self.modulus * round(hidden / self.modulus)

    def _forward(self, index: IntArray) -> BoolArray:
        last = np.int64(-1 if self._last is None else self._last)
        newest = np.maximum.accumulate(np.concatenate([[last], index]))[:-1]
        kept = np.asarray(index > newest)
        if kept.all():
            self._behind = 0
            return kept
        repeated = ~kept & (index == newest)
        backwards = int((~kept & ~repeated).sum())
        self.rejected.update({"duplicate": int(repeated.sum()), "backwards": backwards})
        self._behind = 0 if kept.any() else self._behind + backwards
        return kept

    def _start_anew(self, raw: int, counted: bool, arrival_ns: int) -> None:
        """Go on after the time that passed on the monotonic clock, with the device's new count as it is."""
        before = -1 if self._last is None else self._last
        silent = max(1, round((arrival_ns - self._heard_ns) * self.rate_hz / 1e9))
        self._last, self._raw, self._heard_ns, self._behind = before + silent, raw, arrival_ns, 0
        self.restarts += 1
        if not counted:
            self.origin.value = raw - round(self._last * 1e9 / self.rate_hz)
