"""Samples whose parts come in several frames, put together by the counter that these carry. Pure: no I/O."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.can.tuning import LATE_BEFORE_RESTART, PENDING_SAMPLES
from drivers.port import Counts, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Decoded:
    """Samples: values (n, m), counters or None, times in ns, and the epoch of the counting."""

    values: FloatArray
    counter: IntArray | None
    t_ns: IntArray
    epoch: int = 0


@dataclass(frozen=True, slots=True)
class Part:
    """What one message gave of some samples: counters (as `keys`), values in `columns`, times."""

    number: int
    keys: IntArray
    values: FloatArray
    columns: IntArray
    t_ns: IntArray


@dataclass(frozen=True, slots=True)
class Pending:
    """Samples that are not whole yet: unwrapped counters (n,), increasing, values (n, m), times (n,)."""

    keys: IntArray
    values: FloatArray
    t_ns: IntArray

    @classmethod
    def none(cls, columns: int) -> "Pending":
        """Return no samples."""
        return cls(np.empty(0, np.int64), np.empty((0, columns)), np.empty(0, np.int64))

    def with_keys(self, keys: IntArray) -> "Pending":
        """Return these samples and others, of which nothing has come yet; their time is -1."""
        every = np.union1d(self.keys, keys)
        values, t_ns = np.full((len(every), self.values.shape[1]), np.nan), np.full(len(every), -1, np.int64)
        here = np.searchsorted(every, self.keys)
        values[here], t_ns[here] = self.values, self.t_ns
        return Pending(every, values, t_ns)

    def put(self, keys: IntArray, part: Part, which: slice) -> None:
        """Add some of a part's readings; a sample has the time of the part that came first."""
        rows = np.searchsorted(self.keys, keys)
        values = part.values[which]
        t_ns = part.t_ns[which]
        cells = np.ix_(rows, part.columns)
        self.values[cells] = np.where(np.isnan(values), self.values[cells], values)
        self.t_ns[rows] = np.where(self.t_ns[rows] < 0, t_ns, self.t_ns[rows])

    def cut(self, whole: int) -> "tuple[Pending, Pending]":
        """Return the first `whole` samples, and the others."""
        return (
            Pending(self.keys[:whole], self.values[:whole], self.t_ns[:whole]),
            Pending(self.keys[whole:], self.values[whole:], self.t_ns[whole:]),
        )


class Joiner:
    """Puts samples together from the parts that carry the same counter.

    Each message comes in order, so a sample is final once every message has come with its counter or a newer
    one; a part that never came leaves NaN. Parts of a sample that has gone out already are late and counted
    so.
    """

    def __init__(
        self, parts: int, columns: int, modulus: int, counts: Counts, note: Callable[[str], None]
    ) -> None:
        self._columns = columns
        self._parts = parts
        self._modulus = modulus
        self._counts = counts
        self._note = note
        self._epoch = 0
        self.restart()

    def restart(self) -> None:
        """Forget what is pending; the next counter that comes is the first."""
        self._pending = Pending.none(self._columns)
        self._newest: list[int | None] = [None] * self._parts
        self._emitted: int | None = None
        self._near: int | None = None
        self._late = 0

    def join(self, parts: Sequence[Part]) -> Decoded:
        """Take parts in; return the samples that are final."""
        if self._near is None and parts:
            first = min(parts, key=lambda part: int(part.t_ns[0]))
            self._near = int(first.keys[0])
        for part in parts:
            self._take(part)
        return self._emit()

    def _take(self, part: Part) -> None:
        keys = self._unwrapped(part)
        start = 0
        while start < len(keys):
            stop = self._alike(keys, start)
            some = keys[start:stop]
            if self._is_late(int(some[0])):
                self._count_late(some)
            else:
                self._keep(some, part, slice(start, stop))
            start = stop

    def _is_late(self, key: int) -> bool:
        return self._emitted is not None and key <= self._emitted

    def _alike(self, keys: IntArray, start: int) -> int:
        """Return where keys end that can be taken at once: late ones while no restart falls among them ..."""
        rest = keys[start:]
        if self._is_late(int(rest[0])):
            late = rest <= (self._emitted or 0)
            run = len(rest) if late.all() else int(np.argmin(late))
            return start + min(run, LATE_BEFORE_RESTART + 1 - self._late)
        # ... and others as long as they grow: the second of two alike replaces the first
        fall = np.diff(rest) <= 0
        return start + (int(np.argmax(fall)) + 1 if fall.any() else len(rest))

    def _keep(self, keys: IntArray, part: Part, which: slice) -> None:
        self._late = 0
        self._pending = self._pending.with_keys(keys)
        self._pending.put(keys, part, which)
        newest = self._newest[part.number]
        self._newest[part.number] = int(keys[-1]) if newest is None else max(newest, int(keys[-1]))

    def _unwrapped(self, part: Part) -> IntArray:
        """Return the counters without their wraps, each taken as the one nearest to the one before it."""
        newest = self._newest[part.number]
        before = (self._near or 0) if newest is None else newest
        half = self._modulus // 2
        steps = (np.diff(part.keys, prepend=before) + half) % self._modulus - half
        return before + np.cumsum(steps)

    def _count_late(self, keys: IntArray) -> None:
        self._counts.faults["late part"] += len(keys)
        self._late += len(keys)
        if self._late > LATE_BEFORE_RESTART:
            self._note("the counters ran back and stayed there: the device was restarted")
            self._epoch += 1
            self.restart()
            self._near = int(keys[-1])

    def flush(self) -> Decoded:
        """Return all that is pending, whole or not."""
        return self._release(len(self._pending.keys))

    def _emit(self) -> Decoded:
        keys = self._pending.keys
        seen = [newest for newest in self._newest if newest is not None]
        final = int(np.searchsorted(keys, min(seen), side="right")) if len(seen) == self._parts else 0
        return self._release(max(final, len(keys) - PENDING_SAMPLES))

    def _release(self, whole: int) -> Decoded:
        if whole <= 0:
            return Decoded(
                np.empty((0, self._columns)), np.empty(0, np.int64), np.empty(0, np.int64), self._epoch
            )
        done, self._pending = self._pending.cut(whole)
        self._emitted = self._near = int(done.keys[-1])
        self._counts.received += whole
        return Decoded(done.values, done.keys % self._modulus, done.t_ns, self._epoch)
