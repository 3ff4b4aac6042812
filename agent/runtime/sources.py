"""The reader threads: one a bus connection, each with a bounded queue to the processing thread."""

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from agent.clock import monotonic_ns, wall_ns
from agent.config import RigConfig, driver_class
from agent.config.tables import Source
from agent.recording.recorder import Recorder
from agent.runtime.tuning import QUEUE_SAMPLES, READ_S
from drivers.port import Capture, Counts, Driver, DriverConfigError, SampleBlock, SourceRequest, Trace
from drivers.reconnect import LinkEvent, ReconnectingDriver

log = logging.getLogger(__name__)


class Arrival(NamedTuple):
    """What a reader hands over: a block, and the driver's counts and counter modulus as they were then."""

    block: SampleBlock
    counts: Counts
    modulus: int | None


@dataclass(frozen=True, slots=True)
class Use:
    """One rig's use of a connection: its source, and which block columns are signals, which covariates."""

    rig: str
    source: str
    columns: tuple[int, ...]
    covariates: Mapping[str, int] = field(default_factory=dict)
    base: Counts | None = None
    """What the connection had counted when the use began; None for nothing."""
    base_dropped: Counter[str] = field(default_factory=Counter)

    def counts(self, counts: Counts) -> Counts:
        """Return what was counted since the use began."""
        return counts if self.base is None else _since(counts, self.base)

    def dropped(self, dropped: Counter[str]) -> Counter[str]:
        """Return what was dropped since the use began."""
        return dropped - self.base_dropped


class Connection:
    """A driver, shared by all sources with the same keys, read by a thread of its own.

    Attributes:
        uses: the sources that it serves.
        counts: the driver's counts as they were when what waited was last taken.
        dropped: samples of before it that found the queue full, by reason.
        progress: grows with every turn of the thread; a watchdog may read it.
        make_recorder: makes what records every block, where that is wanted, once the driver is open.
        key: equal for sources that may share it.
    """

    def __init__(
        self, driver: Driver, uses: Sequence[Use], stale_s: float, wake: threading.Event, key: str = ""
    ) -> None:
        self.uses = tuple(uses)
        self.key = key
        self._stale_s = stale_s
        self.dropped: Counter[str] = Counter()
        self.counts = Counts()
        self.progress = 0
        self.make_recorder: Callable[[Driver], Recorder] | None = None
        self._recorder: Recorder | None = None
        self._received = False
        self._stop = threading.Event()
        self._wake = wake
        self._driver = driver
        self._link = ReconnectingDriver(driver, stale_s, stop=self._stop)
        self._waiting: deque[Arrival] = deque()
        self._events: list[LinkEvent] = []
        self._samples = 0
        self._counted = Counts()
        self._overflowed: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._work, name=f"read {driver.request.name}", daemon=True)

    def look_on(self) -> Trace:
        """Return what is shown every unit that comes, beside what it decodes to; called before the start."""
        self._driver.counts.trace = Trace()
        return self._driver.counts.trace

    def start(self) -> None:
        """Begin to read."""
        if self.make_recorder is not None:
            self._driver.keep_capture()
        self._thread.start()

    def end(self) -> None:
        """Ask the thread to end; `stop` waits for it."""
        self._stop.set()

    def stop(self, timeout_s: float = 5.0) -> None:
        """End the thread and close the bus; what was read stays to be taken."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        if self._recorder is not None:
            self._recorder.stop()

    def is_alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    @property
    def name(self) -> str:
        """What status and log call it: the rig and the source that have read it for longest."""
        return f"{self.uses[0].rig}/{self.uses[0].source}" if self.uses else self._driver.request.name

    @property
    def recorder(self) -> Recorder | None:
        """What records it; None where nothing does, or not yet."""
        return self._recorder

    def serves(self, source: Source) -> bool:
        """Tell whether a source of the same key can join while it is read: nothing need be opened anew."""
        request = self._driver.request
        has_fields = set(source.fields) <= set(request.fields)
        is_patient = source.stale_s >= self._stale_s
        return has_fields and is_patient and source.counter in {None, request.counter} and not source.record

    def admit(self, rig: str, source: Source) -> None:
        """Let a source join from the next block on; called by whoever takes, right after taking."""
        own = use_of(rig, source, self._driver.request.fields)
        self.uses = (*self.uses, replace(own, base=self.counts, base_dropped=self.dropped.copy()))

    def leave(self, rigs: Collection[str]) -> None:
        """Let the sources of some rigs go."""
        self.uses = tuple(use for use in self.uses if use.rig not in rigs)

    def take(self) -> tuple[list[Arrival], list[LinkEvent]]:
        """Return what waits, oldest first, and what happened to the link."""
        with self._lock:
            arrivals = list(self._waiting)
            events = self._events
            self._waiting.clear()
            self._events = []
            self._samples = 0
            self.dropped = self._overflowed.copy()
            self.counts = self._counted
        return arrivals, events

    def _work(self) -> None:
        try:
            while not self._stop.is_set():
                self._turn()
        except DriverConfigError as error:
            log.warning("%s: %s", self._driver.request.name, error)
            self._say(LinkEvent("lost", f"{error} (not tried again: mend the configuration)", 0.0))
        except Exception as error:
            # a fault in a driver ends this source, seen by all, and no other
            log.exception("%s: the reader ended by a fault of the driver", self._driver.request.name)
            words = f"the reader ended: {type(error).__name__}: {error} (start the agent anew)"
            self._say(LinkEvent("lost", words, 0.0))
        finally:
            self._close()
            self._wake.set()

    def _close(self) -> None:
        try:
            self._link.close()
        except OSError as error:
            log.warning("%s: %s", self._driver.request.name, error)

    def _turn(self) -> None:
        block, events = self._link.read(READ_S)
        self.progress += 1
        for event in events:
            self._say(event)
        for note in self._driver.take_notes():
            log.info("%s: %s", self._driver.request.name, note)
        noted = replace(block, wall_offset_ns=wall_ns() - monotonic_ns())
        if self.make_recorder is not None:
            self._record(noted, self._driver.take_capture())
        if len(block):
            self._report_first()
            self._put(noted)
        elif self._driver.counts != self._counted:
            self._count()

    def _report_first(self) -> None:
        if not self._received:
            self._received = True
            log.info("%s: delivers samples", self._driver.request.name)

    def _record(self, block: SampleBlock, received: Capture | None) -> None:
        if received is None and not len(block):
            return
        if self._recorder is None and self.make_recorder is not None:
            self._recorder = self.make_recorder(self._driver)
            self._recorder.start()
        if self._recorder is not None:
            self._recorder.record(block, received)

    def _say(self, event: LinkEvent) -> None:
        with self._lock:
            self._events.append(event)
        self._wake.set()

    def _count(self) -> None:
        """Note what a read without samples counted: refused frames and losses are told all the same."""
        with self._lock:
            self._counted = self._driver.counts.copy()

    def _put(self, block: SampleBlock) -> None:
        """Queue a block; where the queue is full the oldest goes and is counted."""
        with self._lock:
            self._counted = self._driver.counts.copy()
            self._waiting.append(Arrival(block, self._counted, self._driver.counter_modulus))
            self._samples += len(block)
            while self._samples > QUEUE_SAMPLES and len(self._waiting) > 1:
                oldest = self._waiting.popleft()
                self._samples -= len(oldest.block)
                self._overflowed["queue full"] += len(oldest.block)
        self._wake.set()


def part(block: SampleBlock, columns: Sequence[int]) -> SampleBlock:
    """Return a block with some of its columns."""
    if list(columns) == list(range(block.values.shape[1])):
        return block
    values = np.ascontiguousarray(block.values[:, list(columns)])
    return replace(block, values=values)


def _since(counts: Counts, base: Counts) -> Counts:
    return Counts(
        counts.received - base.received, counts.rejected - base.rejected, counts.dropped - base.dropped,
        counts.faults - base.faults, counts.reopened - base.reopened, counts.first,
    )  # fmt: skip


def connect(
    configs: Sequence[RigConfig], wake: threading.Event, there: Collection[str] = ()
) -> list[Connection]:
    """Make one connection for each set of identical source keys over all rigs; nothing is opened yet.

    there: keys of connections that exist already.
    """
    grouped: dict[str, list[tuple[RigConfig, Source]]] = {}
    for config in configs:
        for source in (*config.source, *config.covariate_source):
            grouped.setdefault(source.connection(config.folder), []).append((config, source))
    return [_connection(members, wake, key) for key, members in grouped.items() if key not in there]


def _connection(members: Sequence[tuple[RigConfig, Source]], wake: threading.Event, key: str) -> Connection:
    config, first = members[0]
    fields = tuple(dict.fromkeys(name for _, source in members for name in source.fields))
    counter = next((source.counter for _, source in members if source.counter is not None), None)
    driver = driver_class(first.driver)(
        SourceRequest(first.name, first.settings, fields, counter, config.folder)
    )
    uses = [use_of(rig.rig.name, source, fields) for rig, source in members]
    return Connection(driver, uses, min(source.stale_s for _, source in members), wake, key)


def use_of(rig: str, source: Source, fields: tuple[str, ...]) -> Use:
    """Return a rig's use of a connection that delivers these fields."""
    columns = tuple(fields.index(name) for name in source.map.values())
    return Use(
        rig, source.name, columns, {name: fields.index(text) for name, text in source.covariates.items()}
    )


def wire_steps(config: RigConfig) -> Mapping[str, float]:
    """Return the smallest step that each channel's wire can carry, in the reading's unit."""
    steps: dict[str, float] = {}
    for source in config.source:
        answer = _own_driver(config, source).resolution()
        steps.update(zip(source.map, map(float, answer), strict=True))
    return steps


def source_hints(config: RigConfig) -> list[tuple[int, str]]:
    """Return what drivers say of settings that work but may disappoint: the source's number, and words."""
    return [
        (n, hint) for n, source in enumerate(config.source) for hint in _own_driver(config, source).hints()
    ]


def unordered_sources(config: RigConfig) -> list[int]:
    """Return the numbers of the sources that lack what the rig's clock orders samples by."""
    found = []
    for number, source in enumerate(config.source):
        driver = _own_driver(config, source)
        counted = source.counter is not None or driver.counter_modulus is not None
        missing = {"device": True, "counter": not counted}.get(config.rig.clock, False)
        if driver.stamped is False and missing:
            found.append(number)
    return found


def _own_driver(config: RigConfig, source: Source) -> Driver:
    """Return a driver for one source alone, not opened."""
    request = SourceRequest(
        source.name, source.settings, tuple(source.map.values()), source.counter, config.folder
    )
    return driver_class(source.driver)(request)
