"""`deltak run`: the agent in the foreground. One thread a bus, one that computes, one that writes to the database."""

import logging
import signal
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Any

from agent.clock import monotonic_ns
from agent.config import RigConfig, driver_class, load_many
from agent.errors import ConfigError, Fault
from agent.notification.notifier import Notifier
from agent.notification.routing import route
from agent.recording.event_writer import EventWriter
from agent.recording.events import EventKeeper
from agent.recording.setup import event_writer, recorder
from agent.runtime.announcing import announce
from agent.runtime.databases import RunKind, path_of, writers_of
from agent.runtime.limits import ABANDON_S, CLOSE_S, END_S, FINISH_S, HEALTH_PERIOD_NS, HURRY_S, IDLE_S, ROUND_S
from agent.runtime.process.deadline import Deadline
from agent.runtime.process.memory import keep_heap_small, release_free_pages
from agent.runtime.process.opening import Opening
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.source_faults import source_error
from agent.runtime.sources import connect
from agent.types import AlarmTransition
from drivers.port import DriverConfigError

log = logging.getLogger(__name__)


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
        said = announce if kind == "live" else lambda _: None
        self.rigs = {c.rig.name: RigRuntime(c, self._writer_of[c.rig.name].publish, announce=said) for c in configs}
        for writer in self.writers.values():
            writer.on_alarm = self._commanded
        self._event_writers = self._keep_events(configs, db) if kind == "live" else []
        self._notifiers = self._notify(configs, db) if kind == "live" else []
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

    def _commanded(self, step: AlarmTransition) -> None:
        """Let the rig know what was done to an alarm; alarms of rigs that others ran in the same file are not ours."""
        rig = self.rigs.get(step.rig)
        if rig is not None:
            rig.commanded(step)

    def _keep_events(self, configs: Sequence[RigConfig], db: Path | None) -> list[EventWriter]:
        """See that raw samples around alarms are kept, unless the configuration says that none are."""
        found = []
        for config in configs:
            if config.store.events.max_count:
                path = path_of(config, db)
                rig = self.rigs[config.rig.name]
                publish = self.writers[path].publish
                found.append(event_writer(config, path, publish))
                rig.events = EventKeeper(config, found[-1], publish)
        return found

    def _notify(self, configs: Sequence[RigConfig], db: Path | None) -> list[Notifier]:
        """Return what keeps the targets of each database notified; of rigs that share a file those of one name are one.

        They are woken by whoever stores something for them.
        """
        found: dict[tuple[Path, str], Notifier] = {}
        for config in configs:
            path = path_of(config, db)
            for target in config.notify:
                wanted = partial(_is_for, configs, target.name)
                found.setdefault((path, target.name), Notifier(target, config.folder, self.writers[path].ask, wanted))
        for path, writer in self.writers.items():
            writer.on_outbox = partial(_wake, [one for (place, _), one in found.items() if place == path])
        return list(found.values())

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
        self._deadline.in_s(seconds - HURRY_S + ABANDON_S)

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
        for notifier in self._notifiers:
            notifier.start()
        release_free_pages()  # takes its time, in which a serial line would overflow
        for connection in self.connections:
            connection.start()

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

    def _end_notifications(self) -> None:
        for notifier in self._notifiers:
            notifier.stop()

    def _finish(self) -> None:
        begun = monotonic_ns()
        self._end_notifications()
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


def _is_for(configs: Sequence[RigConfig], target: str, step: AlarmTransition) -> bool:
    return target in route(configs, step)


def _wake(notifiers: Sequence[Notifier]) -> None:
    for notifier in notifiers:
        notifier.wake()


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
