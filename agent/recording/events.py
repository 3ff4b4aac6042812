"""Event records: the raw samples from some seconds before an alarm to some seconds after it.

This part lives in the processing thread: it keeps what came last in memory and hands it over when an alarm is
raised, at once with what was before it, so that no later failure takes that away, and again when what comes
after is there. It copies no sample and waits for nothing; files are written by the EventWriter.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from agent.blocks.acquisition.indexing import Indexer, Origin
from agent.clock import wall_ns
from agent.config import RigConfig
from agent.recording.event_files import Labels, Taken
from agent.recording.event_writer import Job
from agent.recording.states import State
from agent.recording.tuning import LEAST_STATE_S, LONGEST_RECORD, MOST_BYTES, OBJECT_BYTES, PATIENCE_S, STATES
from agent.records import EventRecord, HealthEvent, Record
from agent.types import AlarmTransition, EstimateBatch, IntArray
from agent.units import HOUR_S
from drivers.port import SampleBlock

Label = Callable[[IntArray], IntArray]
_OF_YEARS = frozenset({"forecast", "rate"})
"""Kinds of alarms that no moment leads to: the samples around them say nothing."""


def _begins(alarm: AlarmTransition) -> bool:
    """Tell whether the samples around a step of an alarm are kept."""
    return alarm.to_state == "UNACK" and alarm.kind not in _OF_YEARS and not alarm.is_of_agent


class Writer(Protocol):
    """What takes records to the disk."""

    def name(self, kind: str, parameter: str) -> str: ...
    def submit(self, job: Job) -> None: ...


@dataclass(slots=True)
class Open:
    """A record whose end is awaited: until sample number `until`, or `until_s` on the monotonic clock."""

    record: EventRecord
    items: list[Taken]
    labels: list[Labels]
    since: int
    until: int
    until_s: float
    last: int
    last_s: float
    state: State | None = None
    last_round: int = 0


@dataclass(slots=True)
class Memory:
    """What came last: blocks and time stamps that reach `span` samples back, and no more bytes than may be.

    It is cut where the records of what came are known: an alarm may be raised by the first of many new
    samples.
    """

    span: int
    items: deque[Taken] = field(default_factory=deque)
    labels: deque[Labels] = field(default_factory=deque)
    held: int = 0

    def add(self, item: Taken) -> None:
        self.items.append(item)
        self.held += bytes_of(item)

    def cut(self) -> None:
        """Forget what lies further back than the span, or has no room."""
        items = self.items
        while len(items) > 1 and (items[-1].moment - items[0].moment > self.span or self.held > MOST_BYTES):
            self.held -= bytes_of(self.items.popleft())
        while len(self.labels) > 1 and self.labels[-1].number[-1] - self.labels[0].number[-1] > self.span:
            self.labels.popleft()

    def number_at(self, t_ns: int, otherwise: int) -> int:
        """Return the number of the sample with a time stamp; what is given where there is none."""
        for labels in reversed(self.labels):
            place = np.flatnonzero(labels.t_ns == t_ns)
            if len(place):
                return int(labels.number[place[-1]])
        return otherwise


def bytes_of(item: Taken) -> int:
    """Return what a block takes in memory."""
    block = item.block
    arrays = (item.number, item.kept, block.values, block.counter, block.t_ns, block.received_ns)
    return OBJECT_BYTES + sum(array.nbytes for array in arrays if array is not None)


class EventKeeper:
    """The event records of one rig while it runs.

    Args:
        config: the rig's; [store] events says how much is kept.
        writer: takes the records to the disk.
        publish: takes what is to be known of records that are not made.
        clock: monotonic seconds.
    """

    def __init__(
        self,
        config: RigConfig,
        writer: Writer,
        publish: Callable[[list[Record]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._config, self._writer, self._publish, self._clock = config, writer, publish, clock
        limits = config.store.events
        rate = config.rig.sample_rate_hz
        self._after = round(limits.after_s * rate)
        self._after_s = limits.after_s
        self._before = round(limits.before_s * rate)
        self._state_every = max(1, self._before // 2, round(LEAST_STATE_S * rate))
        self._memory = Memory(self._before + round(config.estimator.hop_s * rate) + self._state_every)
        origin = Origin()
        self._indexers = {source.name: Indexer(config.rig.clock, rate, origin) for source in config.source}
        self._moduli: dict[str, int | None] = {}
        self._moment = 0
        self._serial = self._round = 0
        self._states: deque[State] | None = deque(maxlen=STATES)
        self._open: Open | None = None
        self._baselines: dict[str, int | None] = {}
        self._begun: deque[float] = deque()
        self._reported_s = float("-inf")
        self.skipped = 0
        """Alarms for which there is no record, because there had been too many within the hour."""

    def labelled(self, label: Label) -> Label:
        """Return a labelling of samples that is remembered."""

        def remember(index: IntArray) -> IntArray:
            t_ns = label(index)
            if len(index):
                self._moment = max(self._moment, int(index[-1]))
                found = Labels(index, t_ns)
                self._memory.labels.append(found)
                if self._open is not None:
                    self._open.labels.append(found)
            return t_ns

        return remember

    def begin_round(self, snapshot: Callable[[], bytes | None]) -> None:
        """Note that what is taken from now on is computed together, and at times what is known before it."""
        self._round += 1
        if self._states is None or (
            self._states and self._moment - self._states[-1].moment < self._state_every
        ):
            return
        content = snapshot()
        if content is None:
            self._states = None
        else:
            self._states.append(State(content, self._serial, self._moment))

    def take(self, source: str, block: SampleBlock, modulus: int | None) -> None:
        """Remember a block that the pipeline has taken."""
        indexer = self._indexers[source]
        indexer.modulus = self._moduli[source] = modulus
        index, kept = indexer.take(block)
        item = Taken(source, block, index, kept, self._moment, self._serial, self._round)
        self._serial += 1
        self._memory.add(item)
        if self._open is not None:
            self._open.items.append(item)

    def see(self, records: Iterable[Record]) -> None:
        """Begin a record where an alarm was raised, lengthen the open one, end it when its time has come."""
        for record in records:
            if isinstance(record, EstimateBatch):
                learnt = record.baseline_id or ()
                self._baselines = dict(zip(record.parameters, learnt, strict=bool(learnt)))
            elif isinstance(record, AlarmTransition) and _begins(record):
                self._raised(record)
        self.poll()

    def poll(self) -> None:
        """End the record whose time has come; forget what no record to come will hold."""
        self._memory.cut()
        event = self._open
        if event is not None and (self._moment >= event.until or self._clock() >= event.until_s):
            self._end("complete", "" if self._moment >= event.until else "no more samples came")

    def finish(self) -> None:
        """Hand over a record whose end can no longer come."""
        if self._open is not None:
            self._end("cut", "the agent was stopped before all of it had come")

    def _raised(self, alarm: AlarmTransition) -> None:
        now = self._clock()
        at = self._memory.number_at(alarm.t_ns, self._moment)
        if self._open is not None and at > self._open.until:
            self._end("complete", "")
        event = self._open
        if event is None:
            self._begin(alarm, at, now)
            return
        event.record = replace(event.record, alarms=event.record.alarms + 1)
        event.last_round = self._round
        event.until = min(at + self._after, event.last)
        event.until_s = min(now + self._after_s + PATIENCE_S, event.last_s)

    def _begin(self, alarm: AlarmTransition, at: int, now: float) -> None:
        if not self._may_begin(now):
            return
        record = EventRecord(
            alarm.rig, alarm.t_ns, alarm.kind, alarm.parameter, 1,
            self._writer.name(alarm.kind, alarm.parameter),
            "recording", alarm.t_ns, alarm.t_ns, 0, 0, self._baselines.get(alarm.parameter),
        )  # fmt: skip
        until_s = now + self._after_s + PATIENCE_S
        last, last_s = at + LONGEST_RECORD * self._after, now + LONGEST_RECORD * self._after_s + PATIENCE_S
        since = at - self._before
        state = self._state_before(at, since)
        first = self._serial if state is None else state.serial
        items = [item for item in self._memory.items if item.moment >= since or item.serial >= first]
        labels = list(self._memory.labels)
        self._open = Open(
            record, items, labels, since, at + self._after, until_s, last, last_s, state, self._round
        )
        self._submit(record)

    def _state_before(self, at: int, since: int) -> State | None:
        """Return a state before an alarm at a sample, with all since then in memory; it had come to `since`.

        Where rounds are long, the newest one before that.
        """
        there = {item.serial for item in self._memory.items}
        usable = [state for state in self._states or () if state.serial in there and state.moment < at]
        recent = [state for state in usable if state.moment >= since]
        return recent[0] if recent else usable[-1] if usable else None

    def _may_begin(self, now: float) -> bool:
        """Tell whether one more record may begin this hour; the first that may not is reported."""
        while self._begun and now - self._begun[0] > HOUR_S:
            self._begun.popleft()
        if len(self._begun) < self._config.store.events.per_hour:
            self._begun.append(now)
            return True
        self.skipped += 1
        if now - self._reported_s > HOUR_S:
            self._reported_s = now
            words = f"{len(self._begun)} event records were made within the hour; alarms go on without"
            self._publish(
                [HealthEvent(self._config.rig.name, "events", wall_ns(), "event records skipped", words)]
            )
        return False

    def _end(self, state: str, message: str) -> None:
        if self._open is not None:
            self._submit(replace(self._open.record, state=state, message=message))  # type: ignore[arg-type]
            self._open = None

    def _submit(self, record: EventRecord) -> None:
        event = self._open
        if event is not None:
            span = (event.since, event.until)
            self._writer.submit(Job(record, tuple(event.items), tuple(event.labels), span, dict(self._moduli),
                                    event.state, event.last_round))  # fmt: skip
