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
        self._before = self._waited_ns()

    def since_last_s(self) -> float:
        """Return how long the thread that waited longest could run and was not let, since the last call, s.

        0 where the kernel does not say. A thread that hangs cannot run, and does not wait.
        """
        before, self._before = self._before, self._waited_ns()
        waits = [now - before.get(thread, now) for thread, now in self._before.items()]
        return max(waits, default=0) / 1e9

    def _waited_ns(self) -> dict[str, int]:
        """Return what each thread has waited since it began, by its number."""
        found: dict[str, int] = {}
        with suppress(OSError):
            for thread in self._threads.iterdir():
                with suppress(OSError, ValueError, IndexError):  # threads end while they are looked at
                    found[thread.name] = int((thread / "schedstat").read_bytes().split()[1])
        return found
