"""How long this process waited for a processor, as the kernel accounts for it (proc(5), schedstat)."""

from contextlib import suppress
from pathlib import Path

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
