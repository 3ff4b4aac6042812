"""A worker process that reads some rigs' buses and computes. `python -m agent.runtime.workers.child SOCKET`.

It ends when the agent does, however that ends, and leaves signals to it.
"""

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from agent.config import RigConfig
from agent.records import Baseline
from agent.runtime.exchange import Prepared
from agent.runtime.process.memory import keep_heap_small
from agent.runtime.process.service_manager import ServiceManager
from agent.runtime.service import Service
from agent.runtime.tuning import WORKER_END_S
from agent.runtime.workers.link import Link
from agent.runtime.workers.orders import (
    BASELINES,
    BEAT,
    COMMANDED,
    DONE,
    FORGET,
    LOG,
    MAKE,
    PREPARE,
    RUN,
    STOP,
    TAKE_UP,
    Beat,
    Order,
)
from agent.runtime.workers.piped import piped_writers
from agent.types import AlarmTransition

log = logging.getLogger(__name__)


class Beats(ServiceManager):
    """The agent, to which a worker says how it is as often as an agent says it to its service manager."""

    def __init__(self, link: Link, watchdog_s: float | None) -> None:
        super().__init__({} if watchdog_s is None else {"WATCHDOG_USEC": str(round(1e6 * watchdog_s))})
        self._link = link
        self.service: Service | None = None

    def say(self, **fields: object) -> None:
        """Send a beat; what the fields say is said by the agent."""
        del fields
        if self.service is not None:
            beat = Beat(self.service.status.rigs(), self.service.threads())
            self._link.tell(BEAT, beat, spare=True)


class Forwarded(logging.Handler):
    """Has the agent log what a worker logs."""

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record with its format and arguments, by which the agent knows what repeats."""
        args = record.args if isinstance(record.args, tuple) else ()
        is_plain = all(isinstance(arg, str | int | float) for arg in args) and not isinstance(
            record.args, dict
        )
        words = (str(record.msg), args) if is_plain else (record.getMessage(), ())
        if record.exc_info and logging.getLogger().isEnabledFor(logging.DEBUG):
            traceback = logging.Formatter().formatException(record.exc_info)
            words = (f"{record.getMessage()}\n{traceback}".replace("%", "%%"), ())
        self._link.tell(LOG, (record.name, record.levelno, *words), spare=True)


class Child:
    """A worker as it is inside."""

    def __init__(self, connection: Connection) -> None:
        self._service: Service | None = None
        self._prepared: Prepared | None = None
        self._begun = threading.Event()
        self._stopping = threading.Event()
        hears: Mapping[str, Callable[[Any], object]] = {
            RUN: lambda _: self._begun.set(), STOP: lambda _: self._stop(), FORGET: lambda _: self._forget(),
            COMMANDED: self._commanded, BASELINES: self._rebased,
        }  # fmt: skip
        answers: Mapping[str, Callable[[Any], Any]] = {
            MAKE: self._make, PREPARE: self._prepare, TAKE_UP: lambda _: self._take_up(),
        }  # fmt: skip
        self.link = Link(connection, "agent", hears, answers, self._orphaned)

    def run(self) -> int:
        """Do as the agent says until it says that this is the end; return the exit code."""
        self.link.start()
        self._begun.wait()
        if self._service is None or self._stopping.is_set():
            return 0
        try:
            self._service.run(None)
        except Exception:
            # the agent starts another; the traceback is in the log
            log.exception("a worker failed")
            return 1
        self.link.tell(DONE, [rig.summary for rig in self._service.rigs.values()])
        return 0

    def _make(self, order: Order) -> None:
        """Make what the rigs need; nothing is opened yet. Raises what is wrong with the configurations."""
        log_to(self.link, order.levels)
        beats = Beats(self.link, order.watchdog_s)
        make_writers = partial(piped_writers, self.link)
        self._service = Service(
            [own_part(config) for config in order.configs], order.db, order.kind,
            make_writers=make_writers, manager=beats,
        )  # fmt: skip
        beats.service = self._service

    def _prepare(self, configs: Sequence[RigConfig]) -> None:
        self._prepared = self._running().prepare([own_part(config) for config in configs])

    def _take_up(self) -> dict[str, Any]:
        prepared, self._prepared = self._prepared, None
        if prepared is None:
            raise RuntimeError("nothing was prepared")
        return self._running().take_up(prepared)

    def _forget(self) -> None:
        """Give up what was prepared."""
        if self._prepared is not None:
            for writer in self._prepared.parts.writers.values():
                writer.stop(0.0)
        self._prepared = None

    def _running(self) -> Service:
        if self._service is None:
            raise RuntimeError("no rig was ever made")
        return self._service

    def _commanded(self, step: AlarmTransition) -> None:
        rig = self._running().rigs.get(step.rig)
        if rig is not None:
            rig.commanded(step)

    def _rebased(self, given: tuple[Path, Mapping[str, tuple[Baseline, ...]]]) -> None:
        path, baselines = given
        writer = self._running().writers.get(path)
        if writer is not None:
            writer.baselines = {**writer.baselines, **baselines}

    def _stop(self) -> None:
        self._stopping.set()
        if self._service is not None:
            self._service.stop()
        self._begun.set()

    def _orphaned(self) -> None:
        """End soon: nobody writes any more what is computed."""
        timer = threading.Timer(WORKER_END_S, os._exit, (1,))
        timer.daemon = True
        timer.start()
        self._stop()


def own_part(config: RigConfig) -> RigConfig:
    """Return a configuration without what only the agent does: notifying, forwarding, showing metrics."""
    return config.model_copy(update={"notify": (), "north": (), "metrics": type(config.metrics)()})


def log_to(link: Link, levels: Mapping[str, int]) -> None:
    """Have whatever is logged here logged by the agent, which shows it as it was asked to."""
    logging.basicConfig(level=levels.get("", logging.WARNING), handlers=[Forwarded(link)], force=True)
    logging.captureWarnings(capture=True)
    for name, level in levels.items():
        if name:
            logging.getLogger(name).setLevel(level)


def main() -> None:
    """Run a worker whose end of the link is the descriptor of that number."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    keep_heap_small()
    child = Child(Connection(int(sys.argv[1])))
    code = child.run()
    child.link.drain(WORKER_END_S)
    os._exit(code)  # what is still under way is of no use to anybody


if __name__ == "__main__":
    main()
