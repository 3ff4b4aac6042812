"""A worker as the agent sees it: the process, what it said last, and what becomes of it."""

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Final

from agent.clock import monotonic_ns
from agent.config import RigConfig
from agent.kernels import settled
from agent.runtime.process.heartbeats import Thread
from agent.runtime.results import RunSummary
from agent.runtime.tuning import SCORE_ADDED
from agent.runtime.workers.link import Link
from agent.runtime.workers.orders import BEAT, DONE, LOG, MAKE, RUN, STOP, Beat, Order
from agent.runtime.workers.piped import BEGIN, LEFT, RECORDS

_OWN: Final = ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")
"""Variables of the environment that are the agent's alone."""

Acts = Mapping[str, Callable[[Any], Any]]


class Worker:
    """One worker process after the other, under one number.

    Args:
        number: from 1.
        acts: what is done with records and runs: RECORDS, BEGIN, LEFT.
        wake: called when the process is gone.

    Attributes:
        configs: what it runs, by rig.
        restarts: how often it had to be started anew.
        summaries: what its rigs found, once it has done.
        why: in words, why it was killed, where the agent itself did so.
    """

    def __init__(self, number: int, acts: Acts, wake: Callable[[], None]) -> None:
        self.number, self._acts, self._wake = number, acts, wake
        self.configs: dict[str, RigConfig] = {}
        self.restarts = 0
        self.summaries: list[RunSummary] | None = None
        self.why = ""
        self.began_ns = 0
        self._beats = 0
        self._beat: Beat | None = None
        self._beat_ns = 0
        self._link: Link | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, order: Order) -> "Future[Any]":
        """Start a process that is to run what an order says; the answer is there when its rigs are made."""
        here, there = socket.socketpair()
        with there:
            self._process = _process(there.fileno())
        self.configs = {config.rig.name: config for config in order.configs}
        self.began_ns = monotonic_ns()
        self.why, self._beat, self.summaries = "", None, None
        hears: Acts = {RECORDS: self._acts[RECORDS], LEFT: self._acts[LEFT], BEAT: self._note_beat, LOG: _log,
                       DONE: self._note_done}  # fmt: skip
        self._link = Link(
            Connection(here.detach()), f"worker {self.number}", hears, {BEGIN: self._acts[BEGIN]}, self._wake
        )
        self._link.start()
        return self._link.ask(MAKE, order)

    def run(self) -> None:
        """Let it begin."""
        self.tell(RUN)

    def tell(self, what: str, given: Any = None) -> None:
        """Say something to it; nothing happens where it is gone."""
        if self._link is not None:
            self._link.tell(what, given)

    def ask(self, what: str, given: Any = None) -> "Future[Any]":
        """Ask it for something."""
        assert self._link is not None  # noqa: S101 - it was started
        return self._link.ask(what, given)

    @property
    def pid(self) -> int:
        """The number of its process."""
        return 0 if self._process is None else self._process.pid

    @property
    def ended(self) -> bool:
        """Whether all that it ever said has been taken, and it is gone."""
        return self._link is None or self._link.ended

    @property
    def silent_since_start(self) -> bool:
        """Whether it has not said yet how it is."""
        return self._beat is None

    def kill(self, why: str) -> None:
        """End it at once, whatever it is at."""
        self.why = why
        with suppress(OSError):
            if self._process is not None:
                self._process.send_signal(signal.SIGKILL)

    def ending(self) -> str:
        """Return how the process ended, in words, and let the system forget it."""
        code = 0 if self._process is None else self._process.wait()
        if self._link is not None:
            self._link.close()
        words = f"was ended by signal {-code}" if code < 0 else f"ended with exit code {code}"
        return f"worker {self.number} (process {self.pid}) {words}{f': {self.why}' if self.why else ''}"

    def stop(self) -> None:
        """Ask it to end."""
        self.tell(STOP)

    def threads(self) -> list[Thread]:
        """Return itself, whose progress are its beats, and its threads as they were at the newest."""
        beat = self._beat
        if beat is None:
            return [Thread(f"worker {self.number}", 0, alive=False)]
        alive = not self.ended
        own = [thread._replace(name=f"{self._prefix}{thread.name}", alive=thread.alive and alive)
               for thread in beat.threads]  # fmt: skip
        return [Thread(f"worker {self.number}", self._beats, alive), *own]

    def is_among(self, threads: Mapping[str, Any]) -> list[str]:
        """Return those of some threads that are its own."""
        return [name for name in threads if name == f"worker {self.number}" or name.startswith(self._prefix)]

    def rigs(self) -> list[dict[str, Any]]:
        """Return its rigs as status documents, with their lags as they are now."""
        if self._beat is None:
            return []
        age_s = (monotonic_ns() - self._beat_ns) / 1e9
        return [
            {**rig, "lag_s": None if rig["lag_s"] is None else rig["lag_s"] + age_s}
            for rig in self._beat.rigs
        ]

    def document(self) -> dict[str, Any]:
        """Return what the status says of it."""
        return {"worker": self.number, "pid": self.pid, "alive": not self.ended, "rigs": list(self.configs),
                "restarts": self.restarts}  # fmt: skip

    @property
    def _prefix(self) -> str:
        return f"worker {self.number}: "

    def _note_beat(self, beat: Beat) -> None:
        self._beats += 1
        self._beat = beat
        self._beat_ns = monotonic_ns()

    def _note_done(self, summaries: list[RunSummary]) -> None:
        self.summaries = summaries
        self._wake()


def levels() -> dict[str, int]:
    """Return from which level on this process logs, by logger; "" is the root."""
    named = {name: one.level for name, one in logging.Logger.manager.loggerDict.items()
             if isinstance(one, logging.Logger) and one.level}  # fmt: skip
    return {"": logging.getLogger().level, **named}


def _log(given: tuple[str, int, str, tuple[Any, ...]]) -> None:
    name, level, words, args = given
    logging.getLogger(name).handle(logging.LogRecord(name, level, "", 0, words, args, None))


def _process(handle: int) -> "subprocess.Popen[bytes]":
    """Start a worker whose end of the link has a number; it finds the program where this process found it."""
    environment = {name: value for name, value in os.environ.items() if name not in _OWN}
    environment = settled() | environment | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-P", "-m", "agent.runtime.workers.child", str(handle)]
    process = subprocess.Popen(command, pass_fds=(handle,), env=environment, stdin=subprocess.DEVNULL,
                               stdout=subprocess.DEVNULL)  # fmt: skip
    with suppress(OSError):
        score = Path(f"/proc/{process.pid}/oom_score_adj")
        score.write_text(str(min(1000, int(score.read_text()) + SCORE_ADDED)))
    return process
