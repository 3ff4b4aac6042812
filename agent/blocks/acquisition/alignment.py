"""Data acquisition of rigs with several devices, whose channels have delays, clocks and rates of their own.

Rows follow the samples of one source, the reference. Every other channel is read where the reference's
instant lies in its own source: at the same number where devices share a counter, at the place that both
clocks say where they do not, later by the channel's delay and by the skew of its source. Between samples a
reading is interpolated. What is decided depends on each source's own samples, not on whose block came first,
so that a replay gives the same rows.

A device that begins to count anew begins a span of rows, which no row before goes with. The others join it by
their counters where they began anew as well; where one did not, its samples are found by a skew that is
measured anew.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from agent.blocks.acquisition.clock_map import ClockMap
from agent.blocks.acquisition.indexing import Indexer, Origin
from agent.blocks.acquisition.interface import (
    Acquired,
    Acquisition,
    Ends,
    Label,
    SourceEvent,
    SourceState,
    Through,
)
from agent.blocks.acquisition.single_source import uninterrupted
from agent.blocks.acquisition.skew_watch import SkewWatch
from agent.blocks.acquisition.stream import AlignmentPlan, Stream, StreamPlan
from agent.blocks.tuning import NEIGHBOURS, PARTNER_S, SETTLE_S, TOGETHER_S
from agent.numerics.preprocessing.resample import AFTER, interpolated, split
from agent.types import Aligned, BoolArray, FloatArray, IntArray, Samples
from drivers.port import SampleBlock


@dataclass(slots=True)
class Span:
    """Rows from number `since` on, in which no device began to count anew, and what measures their skews."""

    since: int
    watch: SkewWatch | None
    announced: bool = False


class Alignment(Acquisition):
    """The acquisition of one rig with several sources, or with channels that are late.

    Args:
        plan: how rows are made.
        watch: measures the skews of sources; None where there is nothing to measure.
        remeasure: makes a watch of all sources, for when their counters say nothing; None where there is but
            one.
        keep_incomplete: hand on rows that lack some reading (NaN).
    """

    def __init__(
        self, plan: AlignmentPlan, watch: SkewWatch | None = None,
        remeasure: Callable[[], SkewWatch] | None = None,
        *, keep_incomplete: bool = False,
    ) -> None:  # fmt: skip
        origin = Origin(shared=len(plan.streams) > 1)
        self.plan, self._keep_incomplete = plan, keep_incomplete
        self._usual, self._remeasure = watch, remeasure
        self._spans = [Span(-1, watch)]
        self._events: list[SourceEvent] = []
        self.streams = {p.source.name: self._stream(p, origin) for p in plan.streams}
        self.reference = list(self.streams.values())[plan.reference]
        self._patience = round((PARTNER_S + (2 * SETTLE_S if plan.clocks else 0.0)) * plan.rate_hz)
        self._made, self._last, self._segment = -1, -2, 0

    def _stream(self, plan: StreamPlan, origin: Origin) -> Stream:
        own = origin if not plan.own_clock else Origin()
        state = SourceState(plan.source, Indexer(self.plan.clock, plan.rate_hz, own))
        return Stream(plan, state, ClockMap(plan.rate_hz) if self.plan.clocks else None)

    @property
    def sources(self) -> dict[str, SourceState]:
        return {name: stream.state for name, stream in self.streams.items()}

    def step(
        self, source: str, block: SampleBlock, modulus: int | None, label: Label | None = None
    ) -> Acquired:
        stream = self.streams[source]
        stream.take(block, modulus, label if stream is self.reference else None)
        if stream.began_anew():
            self._begin_span(stream)
        return self._acquired(self._advance())

    @property
    def watch(self) -> SkewWatch | None:
        """What measures the skews of the rows to come."""
        return self._spans[-1].watch

    def _begin_span(self, stream: Stream) -> None:
        """Part the rows to come from those before: their numbers count from elsewhere."""
        since = max(stream.state.indexer.began, self._made + 1, self._spans[-1].since)
        own = stream.plan.own_clock
        if len(self.streams) > 1:
            span = Span(
                self._in_rows(stream, since), self._watch_anew(since, needed=not own and self._parted())
            )
            self._spans.append(span)

    def _in_rows(self, stream: Stream, number: int) -> int:
        """Return the row at which a source that has just begun anew goes on."""
        return max(self._made + 1, number if not stream.plan.own_clock else self.reference.newest)

    def _parted(self) -> bool:
        """Whether the counters of sources that share a count no longer say which samples go together."""
        counting = [stream for stream in self.streams.values() if not stream.plan.own_clock]
        return len({stream.state.indexer.generation for stream in counting}) > 1

    def _watch_anew(self, since: int, *, needed: bool) -> SkewWatch | None:
        """Return what measures the skews from row `since` on, beginning with what was usual before."""
        if not needed:
            self._usual = None if self._usual is None else self._usual.anew(since, needed=False)
            return self._usual
        watch = self._watch_of_all()
        return None if watch is None else watch.anew(since, needed=True)

    def _watch_of_all(self) -> SkewWatch | None:
        """Return what measures the skews of all sources: the usual watch where it does, else a new one."""
        usual = self._usual
        if self._remeasure is None:
            return usual
        every = self._remeasure()
        return usual if usual is not None and usual.groups == every.groups else every

    def finish(self) -> Acquired:
        for span in self._spans:
            self._events += [] if span.watch is None else span.watch.let_go()
        pieces = self._advance(end=True)
        for stream in self.streams.values():
            stream.give_up(stream.newest)
        return self._acquired(pieces)

    def hurry(self) -> None:
        for span in list(self._spans):
            if span.watch is not None and span.watch.budget is not None:
                span.watch.budget.close()

    def ends(self, source: str, through: Through) -> Ends:
        stream = self.streams[source]
        return stream.tally.used + stream.waiting, stream.tally.rejected

    def lose(self, reason: str, through: Through) -> None:
        for stream in self.streams.values():
            stream.tally.lose(reason)

    def arrived(self, samples: Sequence[Samples]) -> None:
        for stream in self.streams.values():
            for piece in samples:
                stream.tally.arrive(piece)

    def skews(self) -> dict[str, tuple[float | None, float | None]]:
        return {} if self.watch is None else self.watch.known()

    def _acquired(self, pieces: Sequence[Aligned]) -> Acquired:
        """Return rows, and what was found of the sources while they were made."""
        events, self._events = self._events, []
        return Acquired(pieces, events)

    def _advance(self, *, end: bool = False) -> list[Aligned]:
        """Make the rows that every source is ready for, or has let wait too long, span by span."""
        pieces: list[Aligned] = []
        while len(self._spans) > 1 and self._finished(self._spans[1].since - 1, pieces, end=end):
            self._spans.pop(0)
        if len(self._spans) == 1 and not self._held(self._spans[0]):
            self._make(self._last_due(end=end), pieces)
        self._clear()
        return pieces

    def _finished(self, last: int, pieces: list[Aligned], *, end: bool) -> bool:
        """Make the rows that are due of the oldest span, which ends with `last`; tell whether that is all.

        What was not known of its skews will not be known any more.
        """
        watch = self._spans[0].watch
        if watch is not None:
            watch.end()
        due = self._last_due(end=end)
        self._make(min(due, last), pieces)
        return due >= last

    def _last_due(self, *, end: bool) -> int:
        return self.reference.newest if end else max(self._ready(), self.reference.newest - self._patience)

    def _make(self, last: int, pieces: list[Aligned]) -> None:
        """Make the rows that wait, up to the last one."""
        waiting = self.reference.index[self.reference.index > self._made]
        rows = waiting[: int(np.searchsorted(waiting, last, side="right"))]
        if len(rows):
            pieces += self._rows(rows)

    def _held(self, span: Span) -> bool:
        """Let the skews be measured; tell whether rows wait for that."""
        watch = span.watch
        if watch is None or not all(len(stream.index) for stream in self.streams.values()):
            return False
        ready = self._ready(watch.margin)
        found = watch.look(self._first_common(), ready, self.reference.newest, self._read)
        if (
            watch.needed
            and not span.announced
            and self.reference.newest > span.since + TOGETHER_S * self.plan.rate_hz
        ):
            span.announced = True
            self._announce(watch.against)
        self._events += found
        return watch.holding

    def _announce(self, against: str) -> None:
        """Say whose counters no longer go with the others'."""
        counting = [stream for stream in self.streams.values() if not stream.plan.own_clock]
        newest = max(counting, key=lambda stream: stream.state.indexer.generation).state.plan.name
        others = " and ".join(s.state.plan.name for s in counting if s.state.plan.name != newest)
        words = (
            f"{newest}: its device began to count anew and {others} did not; "
            "how they go together is measured anew"
        )
        self._events.append(SourceEvent(newest if newest != against else others, "realigning", words))

    def _delays(self) -> FloatArray:
        """How much later than the reference each channel is read in the oldest span, (c,), s."""
        watch = self._spans[0].watch
        return self.plan.delay_s if watch is None else self.plan.delay_s + watch.delays()

    def _ready(self, further: int = 0) -> int:
        """Return the last row that can be read from every source, with so many samples after it."""
        delays = self._delays()
        return min(self._ready_of(stream, delays, further) for stream in self.streams.values())

    def _ready_of(self, stream: Stream, delays: FloatArray, further: int) -> int:
        late = delays[list(stream.plan.source.columns)] * stream.plan.rate_hz
        if not self._apart(stream):
            whole, part = split(late)
            return stream.newest - further - int(np.max(whole + np.where(part > 0, AFTER, 0)))
        here, there = self.reference.clock, stream.clock
        if here is None or there is None or not (here.settled and there.settled):
            return -1
        ahead = further * stream.plan.rate_hz / self.plan.rate_hz
        last = there.time_s(np.array([min(stream.newest, there.known) - ahead - AFTER - float(late.max())]))
        return min(int(np.floor(here.place(last)[0])) - 1, here.known)

    def _apart(self, stream: Stream) -> bool:
        """Whether a source and the reference count by clocks of their own."""
        return stream is not self.reference and (stream.plan.own_clock or self.reference.plan.own_clock)

    def _first_common(self) -> int:
        """Return the first row of which every source has a reading."""
        return max(self._first_of(stream) for stream in self.streams.values())

    def _first_of(self, stream: Stream) -> int:
        here = self.reference.clock
        there = stream.clock
        first = int(stream.index[0])
        if not self._apart(stream):
            return first
        if here is None or there is None or not (here.settled and there.settled):
            return first
        return int(np.ceil(here.place(there.time_s(np.array([first])))[0]))

    def _places(self, stream: Stream, rows: IntArray, delay_s: float) -> tuple[IntArray, FloatArray]:
        """Return where rows (n,) lie among a source's samples for a channel this late: whole and part."""
        late = delay_s * stream.plan.rate_hz
        here, there = self.reference.clock, stream.clock
        if not self._apart(stream) or here is None or there is None:
            whole, part = split(np.array([late]))
            return rows + whole[0], np.full(len(rows), part[0])
        return split(there.place(here.time_s(rows.astype(np.float64))) + late)

    def _read(self, rows: IntArray, delays: FloatArray) -> FloatArray:
        """Return readings (n, c) of rows, each channel's as late as configured and `delays` (c,) more."""
        late = self.plan.delay_s + delays
        joined = np.full((len(rows), self.plan.channels), np.nan)
        for stream in self.streams.values():
            for place, channel in enumerate(stream.plan.source.columns):
                if len(stream.index):
                    whole, part = self._places(stream, rows, float(late[channel]))
                    joined[:, channel] = interpolated(stream.index, stream.values[:, place], whole, part)
        return joined

    def _rows(self, rows: IntArray) -> Iterator[Aligned]:
        """Make rows; count where the samples that go with them end up."""
        delays = self._delays()
        joined = self._read(rows, delays - self.plan.delay_s)
        complete = np.isfinite(joined).all(axis=1)
        kept = complete.copy()
        if self._keep_incomplete:
            kept = np.all([self._present(stream, rows, delays) for stream in self.streams.values()], axis=0)
        kept &= ~self._astride(rows, delays)
        for stream in self.streams.values():
            counts = stream.send(self._nearest(stream, rows, delays))
            whole = complete & kept
            stream.tally.send(rows[whole], counts[whole])
            stream.tally.refuse("unpaired", int(counts[~whole].sum()))
        at = np.searchsorted(self.reference.index, rows)
        stamps = self.reference.stamps[at] - round(self.plan.late_s * 1e9)
        self._made = int(rows[-1])
        for piece in uninterrupted(rows[kept], joined[kept], stamps[kept]):
            yield self._numbered(*piece)

    def _astride(self, rows: IntArray, delays: FloatArray) -> BoolArray:
        """Tell which rows (n,) would be read on both sides of where a device began to count anew."""
        reach = AFTER + 1 + round(float(np.abs(delays).max()) * self.plan.rate_hz)
        edges = [span.since for span in self._spans if span.since >= 0]
        return (
            np.any([np.abs(rows - edge) < reach for edge in edges], axis=0)
            if edges
            else np.zeros(len(rows), bool)
        )

    def _nearest(self, stream: Stream, rows: IntArray, delays: FloatArray) -> IntArray:
        whole, part = self._places(stream, rows, float(delays[stream.plan.source.columns[0]]))
        return np.asarray(whole + (part >= 0.5))

    def _present(self, stream: Stream, rows: IntArray, delays: FloatArray) -> BoolArray:
        """Tell for which rows (n,) a source has samples nearby."""
        if not len(stream.index):
            return np.zeros(len(rows), dtype=np.bool_)
        place = self._nearest(stream, rows, delays)
        after = np.minimum(np.searchsorted(stream.index, place), len(stream.index) - 1)
        away = np.minimum(
            np.abs(stream.index[after] - place), np.abs(stream.index[np.maximum(after - 1, 0)] - place)
        )
        reach = max(NEIGHBOURS, round(NEIGHBOURS * stream.plan.rate_hz / self.plan.rate_hz))
        return np.asarray(away <= reach)

    def _numbered(self, index: IntArray, values: FloatArray, stamps: IntArray | None) -> Aligned:
        """Give a piece its segment: a new one unless it follows directly on what was handed on before."""
        if int(index[0]) != self._last + 1:
            self._segment += 1
        inputs, span = self.plan.inputs, self._spans[0]
        anew = self._last < span.since <= int(index[0])
        self._last = int(index[-1])
        unknown = span.watch is not None and span.watch.realigning
        return Aligned(index, values[:, :inputs], values[:, inputs:], stamps, self._segment, anew, unknown)

    def _clear(self) -> None:
        """Drop what no row will need, and refuse what has waited too long for a row."""
        delays = self._delays()
        history = max(8 if span.watch is None else span.watch.history for span in self._spans)
        for stream in self.streams.values():
            rate = stream.plan.rate_hz / self.plan.rate_hz
            needed = (
                self._nearest(stream, np.array([self._made]), delays)[0] if self._placeable(stream) else -1
            )
            if self.reference.newest <= self._made:
                # no row waits: what is older than the patience has no partner to come
                stream.give_up(stream.newest - round(self._patience * rate))
                needed = max(needed, stream.sent)
            late = float(np.min(delays[list(stream.plan.source.columns)], initial=0.0))
            stream.forget(int(needed) - round(history * rate - late * stream.plan.rate_hz) - 8)

    def _placeable(self, stream: Stream) -> bool:
        clocks = self.reference.clock, stream.clock
        return self._made >= 0 and (
            not self._apart(stream) or all(c is not None and c.settled for c in clocks)
        )
