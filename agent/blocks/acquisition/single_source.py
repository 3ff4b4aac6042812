"""Data acquisition and manipulation: blocks of a source become uninterrupted samples in SI units."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from agent.blocks.acquisition.indexing import Clock, Indexer, Origin
from agent.blocks.acquisition.interface import (
    Acquired,
    Acquisition,
    ChannelScale,
    Ends,
    Label,
    SourcePlan,
    SourceState,
    Through,
)
from agent.blocks.tuning import LARGEST_READING
from agent.numerics.preprocessing.rows import rows_with, steps_from
from agent.types import Aligned, BoolArray, FloatArray, IntArray
from drivers.port import SampleBlock


class SingleSource(Acquisition):
    """Acquisition of a rig with one source whose channels are read together; `Alignment` is for all others.

    Args:
        plan: its source.
        inputs: number of model inputs; they are the first channels, the others are outputs.
        clock, rate_hz: what orders samples, and how fast they come.
        keep_incomplete: hand on samples that lack some reading (NaN); they are counted as refused all the
            same.
    """

    def __init__(
        self, plan: SourcePlan, inputs: int, clock: Clock, rate_hz: float, *, keep_incomplete: bool = False
    ) -> None:
        self._keep_incomplete = keep_incomplete
        self._state = SourceState(plan, Indexer(clock, rate_hz, Origin()))
        self._order = np.argsort(plan.columns)
        self._inputs = inputs
        self._last: int | None = None
        self._segment = 0
        self._before: Ends = 0, Counter()

    @property
    def sources(self) -> dict[str, SourceState]:
        """What is known of the source, by its name."""
        return {self._state.plan.name: self._state}

    def step(
        self, source: str, block: SampleBlock, modulus: int | None, label: Label | None = None
    ) -> Acquired:
        index, values, stamps = intake(self._state, block, modulus)
        if not self._keep_incomplete:
            finite = ~rows_with(~np.isfinite(values))
            index, values, stamps = index[finite], values[finite], None if stamps is None else stamps[finite]
        self._state.passed += len(index)
        pieces = [self._numbered(*piece) for piece in uninterrupted(index, values[:, self._order], stamps)]
        return Acquired(
            pieces if label is None else [replace(piece, stamps=label(piece.index)) for piece in pieces]
        )

    def ends(self, source: str, through: Through) -> Ends:
        used, rejected = self._before
        return used + through.used + through.waiting, rejected + through.rejected

    def lose(self, reason: str, through: Through) -> None:
        used, rejected = self._before
        self._before = used + through.used, rejected + through.rejected

    def _numbered(self, index: IntArray, values: FloatArray, stamps: IntArray | None) -> Aligned:
        """Give a piece its segment: a new one unless it follows directly on what was handed on before."""
        if self._last is None or int(index[0]) != self._last + 1:
            self._segment += 1
        self._last = int(index[-1])
        return Aligned(index, values[:, : self._inputs], values[:, self._inputs :], stamps, self._segment)


def intake(
    state: SourceState, block: SampleBlock, modulus: int | None
) -> tuple[IntArray, FloatArray, IntArray | None]:
    """Take a source's block: return numbers (n,) of samples that go forward, SI values (n, c), stamps (n,).

    What is not finite or beyond `LARGEST_READING` is NaN; what goes backwards is left out; all are counted.
    """
    state.indexer.modulus = modulus
    index, kept = state.indexer.take(block)
    values = _to_si(state.plan, block.values)
    impossible = ~(np.abs(values) <= LARGEST_READING)
    sound = ~rows_with(impossible)
    _refuse_values(state, block.values, values, kept & ~sound)
    _count_gaps(state, index[kept & sound])
    values[impossible] = np.nan
    if kept.all():
        return index, values, block.t_ns
    return index[kept], values[kept], None if block.t_ns is None else block.t_ns[kept]


def _to_si(plan: SourcePlan, values: FloatArray) -> FloatArray:
    scale, offset, factor = _scales(plan.scales)
    with np.errstate(over="ignore"):  # what becomes infinite is refused as too large
        return np.asarray((values * scale + offset) * factor)


@lru_cache(maxsize=1024)
def _scales(scales: tuple[ChannelScale, ...]) -> FloatArray:
    """Return scale, offset and factor (3, c) of channels, kept: to convert few samples costs less."""
    return np.array([(s.scale, s.offset, s.factor) for s in scales]).reshape(-1, 3).T.copy()


def _refuse_values(state: SourceState, readings: FloatArray, values: FloatArray, bad: BoolArray) -> None:
    """Count samples (n,) that are not sound, each once; readings (n, c) as they came, values (n, c) in SI."""
    if not bad.any():
        return
    infinite = np.isinf(readings[bad]).any(axis=1)
    large = (np.abs(values[bad]) > LARGEST_READING).any(axis=1) & ~infinite
    missing = ~(infinite | large)
    counts = {"not finite": infinite, "too large": large, "missing value": missing}
    state.rejected.update({reason: int(which.sum()) for reason, which in counts.items()})


def _count_gaps(state: SourceState, index: IntArray) -> None:
    if not len(index):
        return
    before = int(index[0]) - 1 if state.newest is None else state.newest
    steps = steps_from(before, index)
    state.gaps += int((steps > 1).sum())
    state.missing += int((steps - 1).sum())
    state.newest = int(index[-1])


def uninterrupted(
    index: IntArray, values: FloatArray, stamps: IntArray | None
) -> Iterator[tuple[IntArray, FloatArray, IntArray | None]]:
    """Cut at jumps of the index."""
    if not len(index):
        return
    edges = [0, *(np.flatnonzero(np.diff(index) > 1) + 1).tolist(), len(index)]
    for start, stop in pairwise(edges):
        yield index[start:stop], values[start:stop], None if stamps is None else stamps[start:stop]


def source_plan(
    name: str, mapping: Mapping[str, str], channels: Sequence[str], scales: Mapping[str, ChannelScale]
) -> SourcePlan:
    """Make the plan of a source from its map (channel -> field) and the rig's channel names, inputs first."""
    columns = tuple(channels.index(channel) for channel in mapping)
    return SourcePlan(name, columns, tuple(scales[channel] for channel in mapping))
