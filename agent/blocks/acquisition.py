"""Data acquisition and manipulation: blocks of several sources become uninterrupted, aligned samples in SI units."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from agent.blocks.indexing import BoolArray, Clock, Indexer, Origin
from agent.types import FloatArray, IntArray
from drivers.port import SampleBlock

PATIENCE_S = 1.0
"""How long a sample of one source waits for the same instant of another."""


@dataclass(frozen=True, slots=True)
class ChannelScale:
    """SI value = (reading * scale + offset) * factor."""

    scale: float
    offset: float
    factor: float


@dataclass(frozen=True, slots=True)
class SourcePlan:
    """One source's columns: positions among the rig's channels, and how each becomes SI."""

    name: str
    columns: tuple[int, ...]
    scales: tuple[ChannelScale, ...]


@dataclass(slots=True)
class SourceState:
    """What is known of one source.

    passed counts samples handed on to the rig; rejected those refused here, by reason; gaps the jumps of the index.
    """

    plan: SourcePlan
    indexer: Indexer
    passed: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    gaps: int = 0
    missing: int = 0
    newest: int | None = None
    index: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    values: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def refusals(self) -> Counter[str]:
        """All samples refused here, by reason."""
        return self.rejected + self.indexer.rejected


@dataclass(frozen=True, slots=True)
class Aligned:
    """Uninterrupted samples of a rig in SI units.

    Attributes:
        index: (n,) consecutive sample numbers.
        u, y: (n, m) inputs, (n, p) outputs.
        stamps: (n,) the source's own time stamps, ns, where there is a single source that has them.
        segment: counts up at each gap.
    """

    index: IntArray
    u: FloatArray
    y: FloatArray
    stamps: IntArray | None
    segment: int


class Acquisition:
    """The acquisition of one rig.

    Args:
        plans: its sources.
        channels: number of channels; the first `inputs` of them are model inputs, the others outputs.
        inputs: number of model inputs.
        clock, rate_hz: what orders samples, and how fast they come.
        keep_incomplete: hand on samples that lack some reading (NaN); they are counted as refused all the same.
    """

    def __init__(
        self, plans: Sequence[SourcePlan], channels: int, inputs: int, clock: Clock, rate_hz: float, *,
        keep_incomplete: bool = False,
    ) -> None:  # fmt: skip
        self._keep_incomplete = keep_incomplete
        origin = Origin()
        self.sources = {plan.name: SourceState(plan, Indexer(clock, rate_hz, origin)) for plan in plans}
        self._channels, self._inputs, self._rate_hz = channels, inputs, rate_hz
        self._last: int | None = None
        self._segment = 0

    def step(self, source: str, block: SampleBlock, modulus: int | None) -> list[Aligned]:
        """Take a block of one source; return the samples that it leads to, cut at gaps."""
        state = self.sources[source]
        state.indexer.modulus = modulus
        index, kept = state.indexer.take(block)
        values = self._to_si(state.plan, block.values)
        finite = np.isfinite(values).all(axis=1)
        self._refuse_values(state, values, kept & ~finite)
        self._count_gaps(state, index[kept & finite])
        good = kept if self._keep_incomplete else kept & finite
        values[~np.isfinite(values)] = np.nan
        stamps = None if block.t_ns is None else block.t_ns[good]
        index, values = self._aligned(state, index[good], values[good])
        return [self._numbered(*piece) for piece in _uninterrupted(index, values, stamps)]

    def _numbered(self, index: IntArray, values: FloatArray, stamps: IntArray | None) -> Aligned:
        """Give a piece its segment: a new one unless it follows directly on what was handed on before."""
        if self._last is None or int(index[0]) != self._last + 1:
            self._segment += 1
        self._last = int(index[-1])
        return Aligned(index, values[:, : self._inputs], values[:, self._inputs :], stamps, self._segment)

    def _to_si(self, plan: SourcePlan, values: FloatArray) -> FloatArray:
        scale = np.array([s.scale for s in plan.scales])
        offset = np.array([s.offset for s in plan.scales])
        factor = np.array([s.factor for s in plan.scales])
        return np.asarray((values * scale + offset) * factor)

    def _refuse_values(self, state: SourceState, values: FloatArray, bad: BoolArray) -> None:
        if bad.any():
            infinite = np.isinf(values[bad]).any(axis=1)
            state.rejected.update({"not finite": int(infinite.sum()), "missing value": int((~infinite).sum())})

    def _count_gaps(self, state: SourceState, index: IntArray) -> None:
        if not len(index):
            return
        before = index[0] - 1 if state.newest is None else state.newest
        steps = np.diff(index, prepend=before)
        state.gaps += int((steps > 1).sum())
        state.missing += int((steps - 1).sum())
        state.newest = int(index[-1])

    def _aligned(self, state: SourceState, index: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        """Join the sources' columns at common indices; with one source that is the block itself."""
        if len(self.sources) == 1:
            state.passed += len(index)
            return index, values[:, np.argsort(state.plan.columns)]
        state.index = np.concatenate([state.index, index])
        state.values = values if not state.values.size else np.concatenate([state.values, values])
        return self._join()

    def _join(self) -> tuple[IntArray, FloatArray]:
        states = list(self.sources.values())
        common = states[0].index
        for state in states[1:]:
            common = np.intersect1d(common, state.index, assume_unique=True)
        joined = np.empty((len(common), self._channels))
        for state in states:
            rows = np.searchsorted(state.index, common)
            joined[:, list(state.plan.columns)] = state.values[rows] if len(common) else 0.0
            state.passed += len(common)
            self._forget(state, common)
        return common, joined

    def _forget(self, state: SourceState, common: IntArray) -> None:
        """Drop what was joined, and count what can no longer find its partner."""
        newest = max((int(s.index[-1]) for s in self.sources.values() if len(s.index)), default=0)
        done = int(common[-1]) if len(common) else -(2**62)
        horizon = max(done, newest - round(PATIENCE_S * self._rate_hz))
        old = state.index <= horizon
        unpaired = int(old.sum()) - len(common)
        if unpaired:
            state.rejected["unpaired"] += unpaired
        state.index, state.values = state.index[~old], state.values[~old]


def _uninterrupted(
    index: IntArray, values: FloatArray, stamps: IntArray | None
) -> Iterator[tuple[IntArray, FloatArray, IntArray | None]]:
    """Cut at jumps of the index; stamps that are not one an index (several sources) are left out."""
    if not len(index):
        return
    edges = [0, *(np.flatnonzero(np.diff(index) > 1) + 1).tolist(), len(index)]
    usable = stamps if stamps is not None and len(stamps) == len(index) else None
    for start, stop in pairwise(edges):
        yield index[start:stop], values[start:stop], None if usable is None else usable[start:stop]


def source_plan(
    name: str, mapping: Mapping[str, str], channels: Sequence[str], scales: Mapping[str, ChannelScale]
) -> SourcePlan:
    """Make the plan of a source from its map (channel -> field) and the rig's channel names, inputs first."""
    columns = tuple(channels.index(channel) for channel in mapping)
    return SourcePlan(name, columns, tuple(scales[channel] for channel in mapping))


