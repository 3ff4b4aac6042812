"""One at a time on a shared line: of those who wait, the one whose deadline is nearest."""

import heapq
import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class LineLock:
    """Gives a line to one thread at a time, earliest deadline first; equal ones in the order they came.

    A deadline stays what it was while its owner waits, so that nobody waits for ever, and on a line that
    cannot keep up all fall behind alike.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._busy = False
        self._waiting: list[tuple[float, int, threading.Event]] = []
        self._order = itertools.count()

    @contextmanager
    def taken(self, deadline: float) -> Iterator[None]:
        """Have the line to oneself."""
        self._take(deadline)
        try:
            yield
        finally:
            self._give()

    @property
    def waiting(self) -> int:
        """How many wait."""
        return len(self._waiting)

    def _take(self, deadline: float) -> None:
        with self._lock:
            if not self._busy:
                self._busy = True
                return
            mine = threading.Event()
            heapq.heappush(self._waiting, (deadline, next(self._order), mine))
        mine.wait()

    def _give(self) -> None:
        """Hand the line on; it stays busy when somebody waits."""
        with self._lock:
            if self._waiting:
                heapq.heappop(self._waiting)[2].set()
            else:
                self._busy = False
