"""`deltak run`: the agent in the foreground. One thread a bus, one that computes, one that writes to the database."""

import logging
import os
import signal
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from types import FrameType
from typing import Any

from agent.clock import monotonic_ns
from agent.config import RigConfig, driver_class, files_of, load_many
from agent.errors import AgentError, ConfigError, Fault, UsageError
from agent.recording.event_writer import EventWriter
from agent.recording.recorder import Recorder
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.databases import RunKind
from agent.runtime.exchange import Prepared, exchange, plan, prepare, tell
from agent.runtime.limits import (
    ABANDON_S,
    CLOSE_S,
    END_S,
    FINISH_S,
    HEALTH_PERIOD_NS,
    HURRY_S,
    IDLE_S,
    LOG_LINES,
    LOOK_S,
    RELOAD_S,
    ROUND_S,
    SILENCE_S,
    WRITER_PATIENCE,
)
from agent.runtime.process.deadline import Deadline
from agent.runtime.process.heartbeats import Thread
from agent.runtime.process.memory import keep_heap_small, release_free_pages
from agent.runtime.process.opening import Opening
from agent.runtime.process.recent_lines import RecentLines
from agent.runtime.process.service_manager import ServiceManager
from agent.runtime.process.watch import Watch
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.rig_set import RigSet
from agent.runtime.sources import Connection
from agent.runtime.status import Status
from agent.runtime.telemetry.exporters import Exporters
from agent.storage.write.command_socket import Handler
from agent.storage.write.writer import StoreWriter
from drivers.port import DriverConfigError

Reread = Callable[[], Sequence[RigConfig]]
log = logging.getLogger(__name__)


class Service:
    """The agent: connections, rigs and the writers of their databases."""

    def __init__(
        self, configs: Sequence[RigConfig], db: Path | None, kind: RunKind, reread: Reread | None = None
    ) -> None:
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._timers: list[threading.Timer] = []
        self._deadline = Deadline()
        self._reread = reread
        self._asked: SimpleQueue[tuple[Prepared, Future[None]]] = SimpleQueue()
        self._reloading = threading.Lock()
        self._rounds = 0
        self.lines = RecentLines(LOG_LINES)
        self.rig_set = RigSet(db, kind, self._wake, self._handlers())
        self.status = Status(self.rig_set)
        self._watch = Watch(self.threads, self.status.words, ServiceManager(), SILENCE_S, LOOK_S)
        self.status.heartbeats = self._watch.heartbeats
        self._exporters = Exporters(self.status.document)
        self.rig_set.adopt(self.rig_set.make(configs))

    def _handlers(self) -> Mapping[str, Handler]:
        """Return what may be asked for beside the databases."""
        return {
            "status": lambda _: self.status.document(),
            "log": lambda _: {"lines": list(self.lines)},
            "reload": lambda _: self.reload(),
        }

    @property
    def connections(self) -> Sequence[Connection]:
        """What is read."""
        return self.rig_set.connections

    @property
    def rigs(self) -> Mapping[str, RigRuntime]:
        """What is watched, by name."""
        return self.rig_set.rigs

    @property
    def writers(self) -> Mapping[Path, StoreWriter]:
        """What writes to databases, by their files."""
        return self.rig_set.writers

    def threads(self) -> list[Thread]:
        """Return the threads as they are now; from any thread."""
        found = [Thread("processing", self._rounds, self._rounds > 0)]
        for connection in list(self.rig_set.connections):
            name = connection.name
            found.append(Thread(f"read {name}", connection.progress, connection.is_alive()))
            if connection.recorder is not None:
                found.append(_disk_thread(f"record {name}", connection.recorder))
        for path, writer in list(self.rig_set.writers.items()):
            is_watched = writer.is_alive() and not writer.occupied
            found.append(Thread(f"write {path}", writer.progress, is_watched, WRITER_PATIENCE))
        events = list(self.rig_set.event_writers.items())
        return found + [_disk_thread(f"events {name}", writer) for name, writer in events]

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
                self._exchange_asked()
                rest = 0.0 if self._behind() else _rest_s((monotonic_ns() - begun) / 1e9)
                self._stop.wait(min(rest, _patience(started, duration_s)))
                if monotonic_ns() >= ledger_due:
                    ledger_due += HEALTH_PERIOD_NS
                    self.rig_set.ledgers()
        finally:
            self._watch.manager.say(STOPPING=1, STATUS="ending")
            threading.Thread(target=self._exporters.stop, name="metrics end", daemon=True).start()
            self._refuse_asked()
            self._finish()
            self._watch.stop()

    def _start(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Open the databases and the sources; nothing more where it `ended` before the databases were open."""
        self._watch.start()
        opening = Opening(self.writers.values())
        if not opening.done(ended):
            return
        self.rig_set.begin(list(self.rigs))
        self.rig_set.forecasts.start()
        release_free_pages()  # takes its time, in which a serial line would overflow
        self._exporters.exchange(self.rig_set.configs.values())
        for connection in self.connections:
            connection.start()
        self._watch.manager.say(READY=1, STATUS=self.status.words())

    def reload(self) -> dict[str, Any]:
        """Read the configuration again and exchange the rigs that changed; called by any thread but `run`'s.

        A configuration with faults is refused whole, and an event says what they are.

        Returns:
            which rigs were restarted, added, removed and left alone; for one that is refused, its faults.
        """
        if self._reread is None:
            raise UsageError.at("reload", "this agent was not started from files", "start it by deltak run")
        self._watch.manager.say(RELOADING=1, MONOTONIC_USEC=monotonic_ns() // 1000, STATUS="reloading")
        try:
            with self._reloading:
                return self._reloaded(self._reread())
        except (AgentError, DriverConfigError, TimeoutError) as error:
            return self._refused(error)
        finally:
            self._watch.manager.say(READY=1, STATUS=self.status.words())

    def _reloaded(self, configs: Sequence[RigConfig]) -> dict[str, Any]:
        wanted = plan(self.rig_set, configs)
        prepared = prepare(self.rig_set, wanted)
        answer: Future[None] = Future()
        self._asked.put((prepared, answer))
        self._wake.set()
        answer.result(RELOAD_S)
        entered = {config.rig.name for config in wanted.entering}
        return wanted.document([name for name in self.rigs if name not in entered])

    def _refused(self, error: Exception) -> dict[str, Any]:
        faults = getattr(error, "faults", None) or [Fault("reload", str(error) or "it took too long", "see the log")]
        words = "; ".join(str(fault) for fault in faults)
        said = f"the changed configuration is refused, the old one stays: {words}"
        tell(self.rig_set, list(self.rigs), "refused", said)
        return {"refused": [{"path": f.path, "message": f.message, "advice": f.advice} for f in faults]}

    def _exchange_asked(self) -> None:
        """Do the exchanges of rigs that were asked for."""
        while not self._asked.empty():
            prepared, answer = self._asked.get()
            exchange(self.rig_set, prepared, self._deadline.within)
            self._exporters.exchange(self.rig_set.configs.values())
            answer.set_result(None)

    def _refuse_asked(self) -> None:
        while not self._asked.empty():
            _, answer = self._asked.get()
            answer.set_exception(AgentError.at("reload", "the agent is ending", "it reads its files when it starts"))

    def process(self, ended: Callable[[], bool] = lambda: False) -> None:
        """Compute what has arrived, of each rig a part at once, until it `ended`."""
        self._rounds += 1
        self.rig_set.take()
        for name, rig in self.rigs.items():
            if ended():
                return
            rig.count_from(self.rig_set.writer_of(name).baselines.get(name, ()))
            self._deadline.within(rig.work)
            self._rounds += 1
        for rig in self.rigs.values():
            rig.poll()

    def _behind(self) -> bool:
        return any(rig.waiting for rig in self.rigs.values())

    def _settle(self, until: int) -> None:
        """Compute what still waits until then (monotonic, ns); what is left then is dropped."""
        self.rig_set.take()
        while self._behind() and not self._deadline.over and monotonic_ns() < until:
            self.process(lambda: monotonic_ns() >= until)
            self.rig_set.take()
        while self._behind():
            for rig in self.rigs.values():
                rig.give_up()
            self.rig_set.take()

    def _need_writers(self) -> None:
        """Raise where nothing is stored any more: an agent started anew stores again, one that went on would not."""
        for path, writer in self.writers.items():
            if writer.broken is not None:
                raise RuntimeError(f"{path}: the thread that writes to it failed ({writer.broken})")

    def _finish(self) -> None:
        begun = monotonic_ns()
        self.rig_set.forecasts.stop()
        self.rig_set.targets.stop()
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
        self.rig_set.ledgers()
        for events in self.rig_set.event_writers.values():
            events.stop(max(0.3, _left_s(begun, FINISH_S)))
        for writer in self.writers.values():
            writer.stop(max(0.5, _left_s(begun, END_S)))
        for name, rig in self.rigs.items():
            rig.summary.run_id = self.rig_set.writer_of(name).run_ids.get(name, rig.summary.run_id)


def run(
    *, configs: Sequence[Path], db: Path | None, duration_s: float | None, kind: RunKind = "live"
) -> dict[str, Any]:
    """Run the agent; return one rig's document, or {"runs": [...]} for several. kind marks the run in the database.

    configs: files, or folders of them. Raises ConfigError, ModelError, StoreError.
    """
    keep_heap_small()

    def reread() -> Sequence[RigConfig]:
        found = load_many(files_of(configs))
        _need_sources(found)
        return found

    rigs = reread()
    started = monotonic_ns()
    try:
        service = Service(rigs, db, kind, reread)
    except DriverConfigError as error:
        raise source_error(rigs, error) from error
    with service.lines.kept(), _handled(service):
        service.run(duration_s)
    seconds = (monotonic_ns() - started) / 1e9
    documents = [rig.summary.document(seconds) for rig in service.rigs.values()]
    return documents[0] if len(documents) == 1 else {"runs": documents}


@contextmanager
def _handled(service: Service) -> Iterator[None]:
    """Have SIGTERM end a service and SIGHUP reload its configuration; a terminal that is closed still ends it."""
    wanted: dict[signal.Signals, Callable[[], object]] = {signal.SIGTERM: service.stop}
    if not os.isatty(0):
        wanted[signal.SIGHUP] = service.reload
    previous = {number: signal.signal(number, _caller(act)) for number, act in wanted.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _need_sources(rigs: Sequence[RigConfig]) -> None:
    missing = [rig for rig in rigs if not rig.source]
    faults = [Fault("source", f"{rig.file} has no [[source]]", "name the bus to listen to") for rig in missing]
    for rig in rigs:
        for i, source in enumerate((*rig.source, *rig.covariate_source)):
            if driver_class(source.driver).finite:
                faults.append(Fault(f"source[{i}].driver", f'"{source.driver}" is a recording', "use deltak replay"))
    if faults:
        raise ConfigError(faults)


def _caller(act: Callable[[], object]) -> Callable[[int, FrameType | None], None]:
    """Return a signal handler. It interrupts the thread that may hold the very lock that acting takes."""

    def handle(_number: int, _frame: FrameType | None) -> None:
        threading.Thread(target=act, name=getattr(act, "__name__", "signal"), daemon=True).start()

    return handle


def _disk_thread(name: str, writer: Recorder | EventWriter) -> Thread:
    return Thread(name, writer.progress, writer.is_alive(), WRITER_PATIENCE)


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
