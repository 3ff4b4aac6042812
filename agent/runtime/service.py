"""`deltak run`: the agent in the foreground. One thread a bus, one that computes, one that writes to the database."""

import logging
import signal
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from agent.blocks.source_events import Signs, SourceEvents
from agent.clock import SampleLabels, monotonic_ns, wall_ns
from agent.config import RigConfig, driver_class, load_many
from agent.errors import ConfigError, Fault
from agent.recording.event_writer import EventWriter
from agent.recording.events import EventKeeper
from agent.recording.setup import event_writer, recorder
from agent.runtime.containment import IsolatedPipeline
from agent.runtime.databases import RunKind, path_of, writers_of
from agent.runtime.deadline import Deadline
from agent.runtime.lateness import COMPUTING, Lateness
from agent.runtime.memory import keep_heap_small, release_free_pages
from agent.runtime.opening import Opening
from agent.runtime.pending import Waiting
from agent.runtime.pipeline import Conservation
from agent.runtime.results import RunSummary
from agent.runtime.source_faults import source_error
from agent.runtime.sources import Arrival, Connection, Use, connect, part, wire_steps
from agent.storage.tables.alarms import AlarmRow
from agent.types import AlarmTransition, ClockRecord, HealthEvent, IntArray, Learnt, Record
from drivers.port import DriverConfigError
from drivers.reconnect import LinkEvent

HEALTH_PERIOD_NS = 10_000_000_000
IDLE_S = 0.5
ROUND_S = 0.05, 0.25
"""From one round of computing to the next, at least and, where more wait than that takes, at most."""
FINISH_S, END_S = 2.0, 2.8
"""How long an agent that ends goes on with what waits (samples left then are dropped and counted), and takes in all."""
HURRY_S, BREAK_S, CLOSE_S = 1.0, 1.6, 0.6
"""After being asked to end it begins no fit nor search any more, then breaks off one under way; and how long it waits
for readers to end."""

log = logging.getLogger(__name__)


class RigRuntime:
    """One rig while it runs: its pipeline, labels, summary and the alarms of its sources."""

    def __init__(
        self, config: RigConfig, publish: Callable[[Sequence[Record]], None], wall: Callable[[], int] = wall_ns
    ) -> None:
        self.config = config
        self._wall = wall
        self._episodes = SourceEvents()
        self.summary = RunSummary(config)
        maps = {source.name: source.map for source in config.source}
        self.pipeline = IsolatedPipeline(config, wire_steps(config), maps)
        self._labels = SampleLabels(config.rig.sample_rate_hz)
        self._steady = SampleLabels(config.rig.sample_rate_hz)
        self._sampled_ns = 0
        self._publish = publish
        self.events: EventKeeper | None = None
        self._lost: dict[str, bool] = {}
        self._begun_ns = 0
        self._taken: list[tuple[str, Arrival]] = []
        self.waiting = Waiting()
        self._lateness = Lateness(config.rig.name)

    def restore(self, standing: Sequence[AlarmRow], learnt: Learnt | None = None) -> None:
        """Go on with the alarms that the run before left standing, and with what it knew of the rig."""
        self.pipeline.adopt(learnt)
        levels = {row.parameter: {"state": row.state} for row in standing if row.kind == "level"}
        self.pipeline.alarms.restore({"alarms": levels})
        self.pipeline.sensor_alarms.restore(
            [row.parameter for row in standing if row.kind == "sensor" and row.cleared_ns is None]
        )
        lost = [row.parameter for row in standing if row.kind == "source" and row.cleared_ns is None]
        self.pipeline.restore_failure(lost)
        self._lost |= dict.fromkeys(lost, True)
        self._lateness.standing = COMPUTING in lost

    def hurry(self) -> None:
        """Do nothing but what every row takes from now on; from any thread."""
        self.pipeline.hurry()

    def work(self) -> None:
        """Compute a part of what waits."""
        oldest = self.waiting.oldest_ns
        if oldest is not None:
            self._note_lateness(monotonic_ns() - oldest)
        for use, what in self.waiting.part():
            if isinstance(what, LinkEvent):
                self.compute()
                self.link(use.source, what)
            else:
                self.take(use, what)
        self.compute()

    def give_up(self) -> None:
        """Drop the samples that wait, and tell the events."""
        for use, event in self.waiting.drop():
            self.link(use.source, event)

    def take(self, use: Use, arrival: Arrival) -> None:
        """Take one block of one of the rig's sources; `compute` makes estimates of it."""
        seen_s = arrival.block.arrival_ns / 1e9
        if self._lost.get(use.source):
            self.link(use.source, LinkEvent("recovered", f"{use.source}: delivers samples again", seen_s))
        block = part(arrival.block, use.columns)
        offset = wall_ns() - monotonic_ns() if block.wall_offset_ns is None else block.wall_offset_ns
        label = partial(self._label, arrival_ns=block.arrival_ns, offset_ns=offset)
        remembered = label if self.events is None else self.events.labelled(label)
        self.pipeline.take(use.source, block, arrival.modulus, remembered)
        if self.events is not None:
            self.events.take(use.source, block, arrival.modulus)
        self._taken.append((use.source, arrival))

    def _label(self, index: IntArray, arrival_ns: int, offset_ns: int) -> IntArray:
        """Return time stamps (n,) of samples, and note when the newest was taken by the monotonic clock."""
        self._sampled_ns = int(self._steady.label(index[-1:], arrival_ns, 0)[-1])
        return self._labels.label(index, arrival_ns, offset_ns)

    def compute(self) -> None:
        """Publish what the blocks taken since the last call lead to."""
        taken, self._taken = self._taken, []
        if taken:
            self._note_steps()
            self._emit(self.pipeline.compute())
            for source, arrival in taken:
                self._assess(source, arrival, arrival.block.arrival_ns)

    def finish(self) -> None:
        """Publish what the last samples lead to."""
        self._emit(self.pipeline.finish())
        for source, (cause, count) in self._episodes.finish().items():
            self._report(source, cause, count)
        if self.events is not None:
            self.events.finish()

    def poll(self) -> None:
        """End the event record whose time has come, even where no samples come."""
        if self.events is not None:
            self.events.poll()

    def _assess(self, source: str, arrival: Arrival, now_ns: int) -> None:
        """Tell what was counted about a source, once an episode."""
        state = self.pipeline.acquisition.sources[source]
        restarts = state.indexer.restarts
        lost = self.pipeline.rejected(source, arrival.counts) + arrival.counts.dropped
        if len(self.config.source) > 1:
            del lost["spike"]  # of a channel, which may be another source's
        faults = Counter(arrival.counts.faults)
        restarts += faults.pop("restart", 0)
        due = self._episodes.step(source, Signs(restarts, lost, faults, state.gaps), now_ns)
        if due is not None:
            self._report(source, *due)

    def _report(self, source: str, cause: str, count: int) -> None:
        words = f"{source}: {cause}, counted {count} times" if count > 1 else f"{source}: {cause}"
        log.warning("%s: %s", source, words)
        self._emit([HealthEvent(self.config.rig.name, source, self._wall(), cause, words)])

    def _note_lateness(self, waited_ns: int) -> None:
        reported = self._lateness.step(waited_ns, self._wall())
        for record in reported:
            if isinstance(record, HealthEvent):
                log.warning("%s", record.message)
        self._emit(reported)

    def _note_steps(self) -> None:
        """Publish what time stamps mean from now on, before the rows that carry them, and each step of the clock."""
        rig = self.config.rig.name
        found: list[Record] = [ClockRecord(rig, a.label_ns, a.first, a.offset_ns) for a in self._labels.anchors]
        for label, step in self._labels.steps:
            words = f"the wall clock was stepped by {step / 1e9:+.3f} s; time stamps start a new anchor"
            log.warning("%s", f"{words}; rows from before are kept as long as if it had not been")
            found.append(HealthEvent(rig, "clock", label, "clock step", words))
        if found:  # event records have nothing to see in them, and would forget what the rows to come refer to
            self._publish(found)
        self._labels.steps.clear()
        self._labels.anchors.clear()
        self._steady.anchors.clear()

    def link(self, source: str, event: LinkEvent) -> None:
        """Raise or clear a source's alarm and note the event."""
        t_ns, lost, back = self._wall(), event.away, event.cause == "recovered"
        if back and not self._lost.get(source, False):
            return  # its samples have told already
        self._episodes.reported(source, round(event.at_s * 1e9), away=lost)
        log.warning("%s: %s", source, event.message)
        cause = event.kind or event.cause
        records: list[Record] = [HealthEvent(self.config.rig.name, source, t_ns, cause, event.message)]
        if (lost or back) and lost != self._lost.get(source, False):
            self._lost[source] = lost
            records.append(self._source_alarm(source, event, t_ns, lost=lost))
        self._emit(records)

    def _source_alarm(self, source: str, event: LinkEvent, t_ns: int, *, lost: bool) -> AlarmTransition:
        return AlarmTransition(
            rig=self.config.rig.name, kind="source", parameter=source, priority="high", t_ns=t_ns,
            from_state="NORM" if lost else "UNACK", to_state="UNACK" if lost else "RTNUN",
            cause="raise" if lost else "clear", message=event.message,
        )  # fmt: skip

    def ledger(self, connections: Sequence[Connection]) -> None:
        """Publish the conservation ledger of every source, as of the newest sample.

        Before there is one its instant is that of the first ledger, so standstill is one row however long it lasts.
        """
        conservation = {
            use.source: Conservation(*self.waiting.counts(use.source, connection))
            for connection in connections
            for use in connection.uses
            if use.rig == self.config.rig.name
        }
        newest = self.pipeline.newest_ns
        lag = (monotonic_ns() - self._sampled_ns) / 1e9 if newest else None
        if not newest and not self._begun_ns:
            self._begun_ns = self._wall()
        self._emit(self.pipeline.health(conservation, newest or self._begun_ns, lag))

    def _emit(self, records: Sequence[Record]) -> None:
        if records:
            self.summary.take(records)
            self._publish(records)
        if self.events is not None:
            self.events.see(records)


class Service:
    """The agent: connections, rigs and the writers of their databases."""

    def __init__(self, configs: Sequence[RigConfig], db: Path | None, kind: RunKind) -> None:
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._timers: list[threading.Timer] = []
        self._deadline = Deadline()
        self.connections = connect(configs, self._wake)
        self.writers = writers_of(configs, db, kind)
        self._record(configs, db)
        self._writer_of = {c.rig.name: self.writers[path_of(c, db)] for c in configs}
        self.rigs = {c.rig.name: RigRuntime(c, self._writer_of[c.rig.name].publish) for c in configs}
        self._event_writers = self._keep_events(configs, db) if kind == "live" else []
        for config in configs:
            self.rigs[config.rig.name].summary.db = str(path_of(config, db))

    def _record(self, configs: Sequence[RigConfig], db: Path | None) -> None:
        """See that the sources with `record = true` are recorded, in a folder beside the database."""
        wanted = {(c.rig.name, s.name): c for c in configs for s in c.source if s.record}
        for connection in self.connections:
            for use in connection.uses:
                config = wanted.get((use.rig, use.source))
                if config is not None:
                    path = path_of(config, db)
                    connection.make_recorder = partial(recorder, config, path, use.source, self.writers[path].publish)

    def _keep_events(self, configs: Sequence[RigConfig], db: Path | None) -> list[EventWriter]:
        """See that raw samples around alarms are kept, unless the configuration says that none are."""
        found = []
        for config in configs:
            if config.store.events.max_count:
                path, rig = path_of(config, db), self.rigs[config.rig.name]
                publish = self.writers[path].publish
                found.append(event_writer(config, path, publish))
                rig.events = EventKeeper(config, found[-1], publish)
        return found

    def stop(self) -> None:
        """Ask `run` to return; from another thread than `run`'s."""
        self._hurry_in(HURRY_S)
        self._stop.set()
        self._wake.set()

    def _hurry_in(self, seconds: float) -> None:
        """See that whatever is computed after so many seconds is not held up by fits and searches."""
        timer = threading.Timer(seconds, self._hurry)
        timer.daemon = True
        timer.start()
        self._timers.append(timer)
        self._deadline.in_s(seconds - HURRY_S + BREAK_S)

    def _hurry(self) -> None:
        for rig in self.rigs.values():
            rig.hurry()
        for writer in self.writers.values():
            writer.hurry()

    def run(self, duration_s: float | None) -> None:
        """Read, compute and store until stopped or duration_s has passed.

        Raises StoreError where a database can never be opened, RuntimeError where a writer ended by a fault of its own.
        """
        started = monotonic_ns()

        def ended() -> bool:
            return self._stop.is_set() or not _patience(started, duration_s)

        if duration_s is not None:
            self._hurry_in(duration_s + HURRY_S)
        try:
            self._start(ended)
            ledger_due = started + HEALTH_PERIOD_NS
            while not ended():
                self._wake.wait(0.0 if self._behind() else _patience(started, duration_s))
                self._wake.clear()
                begun = monotonic_ns()
                self.process(ended)
                self._need_writers()
                rest = 0.0 if self._behind() else _rest_s((monotonic_ns() - begun) / 1e9)
                self._stop.wait(min(rest, _patience(started, duration_s)))
                if monotonic_ns() >= ledger_due:
                    ledger_due += HEALTH_PERIOD_NS
                    self._ledgers()
        finally:
            self._finish()

    def _start(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Open the databases and the sources; nothing more where it `ended` before the databases were open."""
        opening = Opening(self.writers.values())
        if not opening.done(ended):
            return
        for events in self._event_writers:
            events.start()
        for name, rig in self.rigs.items():
            writer = self._writer_of[name]
            rig.summary.run_id = writer.run_ids.get(name)
            rig.restore(writer.standing.get(name, []), writer.learnt.get(name))
        for connection in self.connections:
            connection.start()
        release_free_pages()

    def process(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Compute what has arrived, of each rig a part at once, until it `ended`."""
        self._take()
        for rig in self.rigs.values():
            if ended():
                return
            self._deadline.within(rig.work)
        for rig in self.rigs.values():
            rig.poll()

    def _take(self) -> None:
        """Hand out what has arrived, in the order of arrival over all sources, but for rigs that are behind.

        What comes for those stays in the queues of its connections, which are bounded.
        """
        behind = {name for name, rig in self.rigs.items() if rig.waiting}
        free = [connection for connection in self.connections if not behind & {use.rig for use in connection.uses}]
        taken = [(connection, *connection.take()) for connection in free]
        arrived = [(arrival, connection) for connection, arrivals, _ in taken for arrival in arrivals]
        for arrival, connection in sorted(arrived, key=lambda pair: pair[0].block.arrival_ns):
            for use in connection.uses:
                self.rigs[use.rig].waiting.add(use, arrival)
        # samples first: those that came before a loss must not end it
        for connection, _, events in taken:
            for use in connection.uses:
                for event in events:
                    self.rigs[use.rig].waiting.add(use, event)

    def _behind(self) -> bool:
        return any(rig.waiting for rig in self.rigs.values())

    def _settle(self, until: int) -> None:
        """Compute what still waits until then (monotonic, ns); what is left then is dropped."""
        self._take()
        while self._behind() and not self._deadline.over and monotonic_ns() < until:
            self.process(lambda: monotonic_ns() >= until)
            self._take()
        while self._behind():
            for rig in self.rigs.values():
                rig.give_up()
            self._take()

    def _need_writers(self) -> None:
        """Raise where nothing is stored any more: an agent started anew stores again, one that went on would not."""
        for path, writer in self.writers.items():
            if writer.broken is not None:
                raise RuntimeError(f"{path}: the thread that writes to it failed ({writer.broken})")

    def _ledgers(self) -> None:
        for rig in self.rigs.values():
            rig.ledger(self.connections)

    def _finish(self) -> None:
        begun = monotonic_ns()
        for writer in self.writers.values():
            writer.hurry()
        for connection in self.connections:
            connection.end()
        for connection in self.connections:
            connection.stop(max(0.1, _left_s(begun, CLOSE_S)))
        self._settle(begun + round(FINISH_S * 1e9))
        for rig in self.rigs.values():
            if not self._deadline.within(rig.finish):
                log.warning("%s: what was being computed at the end is not stored", rig.config.rig.name)
        for timer in self._timers:
            timer.cancel()
        self._deadline.end()
        self._ledgers()
        for events in self._event_writers:
            events.stop(max(0.3, _left_s(begun, FINISH_S)))
        for writer in self.writers.values():
            writer.stop(max(0.5, _left_s(begun, END_S)))
        for name, rig in self.rigs.items():
            rig.summary.run_id = self._writer_of[name].run_ids.get(name, rig.summary.run_id)


def run(
    *, configs: Sequence[Path], db: Path | None, duration_s: float | None, kind: RunKind = "live"
) -> dict[str, Any]:
    """Run the agent; return one rig's document, or {"runs": [...]} for several. kind marks the run in the database.

    Raises ConfigError, ModelError, StoreError.
    """
    keep_heap_small()
    rigs = load_many(configs)
    _need_sources(rigs)
    started = monotonic_ns()
    try:
        service = Service(rigs, db, kind)
    except DriverConfigError as error:
        raise source_error(rigs, error) from error
    previous = {number: signal.signal(number, _stopper(service)) for number in (signal.SIGTERM,)}
    try:
        service.run(duration_s)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    seconds = (monotonic_ns() - started) / 1e9
    documents = [rig.summary.document(seconds) for rig in service.rigs.values()]
    return documents[0] if len(documents) == 1 else {"runs": documents}


def _need_sources(rigs: Sequence[RigConfig]) -> None:
    missing = [rig for rig in rigs if not rig.source]
    faults = [Fault("source", f"{rig.file} has no [[source]]", "name the bus to listen to") for rig in missing]
    for rig in rigs:
        for i, source in enumerate(rig.source):
            if driver_class(source.driver).finite:
                faults.append(Fault(f"source[{i}].driver", f'"{source.driver}" is a recording', "use deltak replay"))
    if faults:
        raise ConfigError(faults)


def _stopper(service: Service) -> Callable[[int, FrameType | None], None]:
    """Return a signal handler. It interrupts the thread that may hold the very lock that stopping takes."""

    def stop(_number: int, _frame: FrameType | None) -> None:
        threading.Thread(target=service.stop, name="stop", daemon=True).start()

    return stop


def _rest_s(spent_s: float) -> float:
    """Return how long to let blocks gather after a round that took so long: three times as long where that may be."""
    least, most = ROUND_S
    return max(0.0, min(most, max(least, 4 * spent_s)) - spent_s)


def _left_s(begun: int, seconds: float) -> float:
    """Return what is left of some seconds from an instant (monotonic, ns) on."""
    return seconds - (monotonic_ns() - begun) / 1e9


def _patience(started: int, duration_s: float | None) -> float:
    if duration_s is None:
        return IDLE_S
    return max(0.0, min(IDLE_S, duration_s - (monotonic_ns() - started) / 1e9))
