"""`deltak run`: the agent in the foreground. One thread a bus, one to compute, one to write the database."""

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from agent.clock import monotonic_ns
from agent.config import RigConfig
from agent.config.sections.process import agreed
from agent.errors import AgentError, Fault, UsageError
from agent.recording.event_writer import EventWriter
from agent.recording.recorder import Recorder
from agent.runtime.exchange import Prepared, exchange, plan, prepare, tell
from agent.runtime.process.databases import RunKind, Writer, writers_of
from agent.runtime.process.deadline import Deadline
from agent.runtime.process.heartbeats import Thread
from agent.runtime.process.memory import release_free_pages
from agent.runtime.process.opening import Opening
from agent.runtime.process.recent_lines import RecentLines
from agent.runtime.process.service_manager import ServiceManager
from agent.runtime.process.watch import Watch
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.rig_set import MakeWriters, RigSet
from agent.runtime.sources import Connection
from agent.runtime.status import Status
from agent.runtime.telemetry.exporters import Exporters
from agent.runtime.tuning import (
    ABANDON_S,
    CLOSE_S,
    END_S,
    FINISH_S,
    HEALTH_PERIOD_NS,
    HURRY_S,
    IDLE_S,
    LOG_LINES,
    LONGEST_ROUND,
    LONGEST_ROUND_S,
    LOOK_S,
    PEER_PATIENCE,
    RELOAD_S,
    SILENCE_S,
    WRITER_PATIENCE,
)
from agent.storage.write.command_socket import Handler
from drivers.port import DriverConfigError

Reread = Callable[[], Sequence[RigConfig]]
log = logging.getLogger(__name__)


class Service:
    """The agent: connections, rigs and the writers of their databases.

    Args:
        configs: what it runs.
        db: the database of all, where the command line names one.
        kind: what their runs are marked as.
        reread: reads the configurations again, for a reload.
        make_writers: makes what writes to databases.
        manager: hears how it is; whoever started it as a service, if nobody else is named.
    """

    def __init__(
        self,
        configs: Sequence[RigConfig],
        db: Path | None,
        kind: RunKind,
        reread: Reread | None = None,
        *,
        make_writers: MakeWriters = writers_of,
        manager: ServiceManager | None = None,
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
        self.rig_set = RigSet(db, kind, self._wake, self._handlers(), make_writers=make_writers)
        self.status = Status(self.rig_set)
        self._watch = Watch(self.threads, self.status.words, manager or ServiceManager(), SILENCE_S, LOOK_S)
        self.status.heartbeats = self._watch.heartbeats
        self._exporters = Exporters(self.status.document)
        self._round_s = agreed([(config.file, config.agent) for config in configs])[0].round_s
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
    def writers(self) -> Mapping[Path, Writer]:
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
        for path, writer in self.rig_set.stores.items():
            is_watched = writer.is_alive() and not writer.occupied
            found.append(Thread(f"write {path}", writer.progress, is_watched, WRITER_PATIENCE))
        for forwarder in self.rig_set.forwarding.forwarders:
            name = forwarder.consumer.name
            found.append(Thread(f"north {name}", forwarder.progress, forwarder.is_alive(), PEER_PATIENCE))
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

        Raises StoreError where a database can never be opened, RuntimeError where a writer ended by a fault
        of its own.
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
                rest = 0.0 if self._behind() else _rest_s((monotonic_ns() - begun) / 1e9, self._round_s)
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
        """Open the databases and sources; nothing more where it `ended` before the databases were open."""
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
        with self._reloading:  # one after the other, so that READY=1 comes when none is under way
            self._watch.manager.say(RELOADING=1, MONOTONIC_USEC=monotonic_ns() // 1000, STATUS="reloading")
            try:
                return self._reloaded(self._reread())
            except (AgentError, DriverConfigError, TimeoutError) as error:
                return self._refused(error)
            finally:
                self._watch.manager.say(READY=1, STATUS=self.status.words())

    def _reloaded(self, configs: Sequence[RigConfig]) -> dict[str, Any]:
        """Exchange rigs; an agent of several workers does so over them."""
        return self.take_up(self.prepare(configs))

    def prepare(self, configs: Sequence[RigConfig]) -> Prepared:
        """Make and open what other configurations need; what runs is untouched. From any thread but `run`'s.

        Raises AgentError or DriverConfigError where something cannot be made or opened.
        """
        return prepare(self.rig_set, plan(self.rig_set, configs))

    def take_up(self, prepared: Prepared) -> dict[str, Any]:
        """Have rigs exchanged; returns which were, and which were left alone. From any thread but `run`'s."""
        answer: Future[None] = Future()
        self._asked.put((prepared, answer))
        self._wake.set()
        answer.result(RELOAD_S)
        entered = {config.rig.name for config in prepared.plan.entering}
        return prepared.plan.document([name for name in self.rigs if name not in entered])

    def _refused(self, error: Exception) -> dict[str, Any]:
        faults = getattr(error, "faults", None) or [
            Fault("reload", str(error) or "it took too long", "see the log")
        ]
        words = "; ".join(str(fault) for fault in faults)
        said = f"the changed configuration is refused, the old one stays: {words}"
        tell(self.rig_set, list(self.rig_set.configs), "refused", said)
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
            answer.set_exception(
                AgentError.at("reload", "the agent is ending", "it reads its files when it starts")
            )

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

    def documents(self, seconds: float) -> list[dict[str, Any]]:
        """Return what each rig's run found, after it took so long."""
        return [rig.summary.document(seconds) for rig in self.rigs.values()]

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
        """Raise where nothing is stored any more: a new agent stores again, one that went on would not."""
        for path, writer in self.writers.items():
            if writer.broken is not None:
                raise RuntimeError(f"{path}: the thread that writes to it failed ({writer.broken})")

    def _finish(self) -> None:
        begun = monotonic_ns()
        self.rig_set.forecasts.stop()
        self.rig_set.targets.stop()
        self.rig_set.forwarding.stop()
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


def _disk_thread(name: str, writer: Recorder | EventWriter) -> Thread:
    return Thread(name, writer.progress, writer.is_alive(), WRITER_PATIENCE)


def _rest_s(spent_s: float, least_s: float) -> float:
    """Return how long to let blocks gather after a round that took so long: three times as long if allowed.

    least_s: from one round to the next at least; the longest time between two shrinks with it.
    """
    most_s = min(LONGEST_ROUND * least_s, LONGEST_ROUND_S)
    return max(0.0, max(least_s, min(most_s, 4 * spent_s)) - spent_s)


def _left_s(begun: int, seconds: float) -> float:
    """Return what is left of some seconds from an instant (monotonic, ns) on."""
    return seconds - (monotonic_ns() - begun) / 1e9


def _patience(started: int, duration_s: float | None) -> float:
    if duration_s is None:
        return IDLE_S
    return max(0.0, min(IDLE_S, duration_s - (monotonic_ns() - started) / 1e9))
