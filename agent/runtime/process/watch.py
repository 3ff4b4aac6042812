"""The thread that watches all others, and feeds the service manager's watchdog while each makes progress."""

import logging
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from agent.clock import monotonic_ns
from agent.runtime.process.heartbeats import Heartbeats, Thread
from agent.runtime.process.service_manager import ServiceManager
from agent.runtime.tuning import LOOKS_AN_INTERVAL

THREADS = Path("/proc/self/task")


class ProcessorWait:
    """The waits of this process's threads.

    Args:
        threads: the folder with a folder a thread.
    """

    def __init__(self, threads: Path = THREADS) -> None:
        self._threads = threads
        self._before = self._spent()

    def since_last_s(self) -> float:
        """Return how long the thread that waited longest could run and was not let, since the last call, s.

        Without the time in which this process's own threads ran. 0 where the kernel does not say. A thread
        that hangs cannot run, and does not wait.
        """
        before, self._before = self._before, self._spent()
        ran = waited = 0
        for thread, now in self._before.items():
            then = before.get(thread, now)
            ran += now[0] - then[0]
            waited = max(waited, now[1] - then[1])
        return max(0, waited - ran) / 1e9

    def _spent(self) -> dict[str, tuple[int, int]]:
        """Return for how long each thread ran and waited since it began, ns, by its number."""
        found: dict[str, tuple[int, int]] = {}
        with suppress(OSError):
            for thread in self._threads.iterdir():
                with suppress(OSError, ValueError):  # threads end while they are looked at
                    ran, waited, _ = (thread / "schedstat").read_bytes().split()
                    found[thread.name] = int(ran), int(waited)
        return found


log = logging.getLogger(__name__)


class Watch:
    """Looks at the heartbeats once a period; a thread that stalls is named in the log and ends the feeding.

    Args:
        threads: the agent's threads as they are now.
        status: the agent in one line.
        manager: who is told.
        silence_s: for how long a thread may make no progress where the manager sets no interval.
        look_s: threads are looked at this often at least.
    """

    def __init__(
        self,
        threads: Callable[[], Iterable[Thread]],
        status: Callable[[], str],
        manager: ServiceManager,
        silence_s: float,
        look_s: float,
    ) -> None:
        self.manager = manager
        interval_s = manager.watchdog_s or silence_s
        self._period_s = min(look_s, interval_s / LOOKS_AN_INTERVAL)
        self.heartbeats = Heartbeats(threads, interval_s, self._period_s, ProcessorWait().since_last_s)
        self._status = status
        self._stalled: list[str] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="watch", daemon=True)

    def start(self) -> None:
        """Begin to watch."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; harmless where it never began."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(self._period_s)

    def step(self, now_ns: int) -> None:
        """Look once, at a monotonic instant."""
        stalled = self.heartbeats.look(now_ns)
        for name in stalled:
            if name not in self._stalled:
                silent_s = self.heartbeats.beats[name].silent_s
                log.error(
                    "%s: the thread makes no progress since %.1f s; the watchdog is not fed", name, silent_s
                )
        self._stalled = stalled
        if stalled:
            self.manager.say(STATUS=f"no progress: {', '.join(stalled)}")
        else:
            self.manager.say(WATCHDOG=1, STATUS=self._status())

    def _work(self) -> None:
        while not self._stop.is_set():
            self.step(monotonic_ns())
            self._stop.wait(self._period_s)
