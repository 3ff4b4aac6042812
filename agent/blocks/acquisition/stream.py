"""One source among several while it runs: what of its samples is kept, where they ended up, its clock."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from agent.blocks.acquisition.clock_map import ClockMap
from agent.blocks.acquisition.indexing import Clock
from agent.blocks.acquisition.interface import (
    Label,
    SourcePlan,
    SourceState,
)
from agent.blocks.acquisition.single_source import intake
from agent.types import FloatArray, IntArray, Samples
from drivers.port import SampleBlock


@dataclass(slots=True)
class Tally:
    """The samples of one source on their way through rows.

    A row takes along as many samples as fell to it: one, seldom none or two where the device's clock runs at
    its own speed, several where the device is the faster one.

    Attributes:
        used: samples of rows that entered the estimation whole.
        rejected: samples of rows that were refused, by reason.
    """

    used: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    _rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _weight: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def waiting(self) -> int:
        """Samples of rows that are not through yet."""
        return int(self._weight.sum())

    def send(self, rows: IntArray, weight: IntArray) -> None:
        """Note rows (n,) that are handed on whole, and the samples (n,) that go with each."""
        self._rows, self._weight = np.concatenate([self._rows, rows]), np.concatenate([self._weight, weight])

    def refuse(self, reason: str, count: int) -> None:
        """Note samples of which no row is made."""
        if count:
            self.rejected[reason] += count

    def lose(self, reason: str) -> None:
        """Refuse the samples of the rows that are not through: they will not come out."""
        self.refuse(reason, self.waiting)
        self._rows, self._weight = self._rows[:0], self._weight[:0]

    def arrive(self, samples: Samples) -> None:
        """Note rows that came out of the quality block."""
        last = int(np.searchsorted(self._rows, samples.index[-1], side="right"))
        mine, weight = self._rows[:last], self._weight[:last]
        self._rows, self._weight = self._rows[last:], self._weight[last:]
        at = np.searchsorted(mine, samples.index)
        found = at < len(mine)
        found[found] = mine[at[found]] == samples.index[found]
        counts = np.where(found, weight[np.minimum(at, max(len(mine) - 1, 0))] if len(mine) else 0, 0)
        if samples.usable:
            sound = samples.complete
            self.used += int(counts[sound].sum())
            self.refuse("spike", int(counts[~sound].sum()))
        elif samples.fault is not None:
            self.refuse(samples.fault.reason.name.lower(), int(counts.sum()))
        self.refuse("unpaired", int(weight.sum() - counts.sum()))


@dataclass(frozen=True, slots=True)
class StreamPlan:
    """One source: its columns, its device's sampling rate, and whether the device counts for itself."""

    source: SourcePlan
    rate_hz: float
    own_clock: bool = False


@dataclass(frozen=True, slots=True)
class AlignmentPlan:
    """How the sources of a rig become rows.

    Attributes:
        streams: the sources; `reference` is the place of the one whose samples make rows.
        channels, inputs: number of channels, of which the first are inputs.
        clock, rate_hz: what orders samples, and how fast rows come.
        delay_s: (c,) how much later than the reference's first channel each is read, as far as that is
            configured.
        late_s: how late that first channel is itself.
    """

    streams: tuple[StreamPlan, ...]
    reference: int
    channels: int
    inputs: int
    clock: Clock
    rate_hz: float
    delay_s: FloatArray
    late_s: float = 0.0

    @property
    def clocks(self) -> bool:
        """Whether some device counts for itself."""
        return any(stream.own_clock for stream in self.streams)


@dataclass(slots=True)
class Stream:
    """One source while it runs: what of its samples is kept, where they ended up, its clock."""

    plan: StreamPlan
    state: SourceState
    clock: ClockMap | None
    tally: Tally = field(default_factory=Tally)
    index: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    values: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    stamps: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    sent: int = -1
    _restarts: int = 0

    def began_anew(self) -> bool:
        """Tell whether the device began to count anew since the last call."""
        before, self._restarts = self._restarts, self.state.indexer.restarts
        return self._restarts > before

    @property
    def newest(self) -> int:
        """Number of the newest sample; -1 before there is one."""
        return int(self.index[-1]) if len(self.index) else -1

    @property
    def waiting(self) -> int:
        """Complete samples that wait for their row, or for what is made of it."""
        open_ = self.index > self.sent
        return (
            int(np.isfinite(self.values[open_]).all(axis=1).sum()) + self.tally.waiting
            if len(self.index)
            else 0
        )

    def take(self, block: SampleBlock, modulus: int | None, label: Label | None) -> None:
        """Keep a block's samples, also those lacking a reading, with stamps of `label` or else their own."""
        restarts = self.state.indexer.restarts
        index, values, stamps = intake(self.state, block, modulus)
        if self.clock is not None and self.state.indexer.restarts > restarts:
            self.clock.restart()
        if not len(index):
            return
        times = (
            label(index)
            if label is not None
            else _by_rate(index, self.plan.rate_hz)
            if stamps is None
            else stamps
        )
        self.index, self.stamps = np.concatenate([self.index, index]), np.concatenate([self.stamps, times])
        self.values = np.concatenate([self.values, values]) if self.values.size else values
        if self.clock is not None:
            self.clock.observe(int(index[-1]), block.arrival_ns)

    def send(self, last: IntArray) -> IntArray:
        """Return how many complete samples (n,) go with rows that take along all up to last (n,)."""
        complete = self.index[np.isfinite(self.values).all(axis=1)] if len(self.index) else self.index
        edges = np.searchsorted(
            complete, np.maximum.accumulate(np.concatenate([[self.sent], last])), side="right"
        )
        self.sent = max(self.sent, int(last[-1]))
        return np.diff(edges)

    def give_up(self, last: int) -> None:
        """Refuse the samples up to one that no row takes along."""
        if last > self.sent:
            self.tally.refuse("unpaired", int(self.send(np.array([last])).sum()))

    def forget(self, before: int) -> None:
        """Drop the samples before one."""
        cut = int(np.searchsorted(self.index, min(before, self.sent)))
        self.index, self.values, self.stamps = self.index[cut:], self.values[cut:], self.stamps[cut:]
        if self.clock is not None:
            self.clock.forget(before)


def _by_rate(index: IntArray, rate_hz: float) -> IntArray:
    period = np.longdouble(1e9) / np.longdouble(rate_hz)
    return np.asarray(np.rint(index * period).astype(np.int64))
