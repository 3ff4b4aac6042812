"""How many samples the rig has taken: by the monotonic clock, or, played fast, by what readers have taken."""

import threading
import time
from collections.abc import Callable, Iterable
from typing import Literal

from sim_bus.tuning import LAG_SAMPLES

NS = 1_000_000_000  # fixed by units: nanoseconds of a second


class PlayClock:
    """The clock that all devices of a rig share. Sample 0 is taken when it starts.

    Args:
        sample_rate_hz: samples a second.
        total: samples to play; None is without end.
        sources: the sources that have a device.
        start: "reader": starts when each of them has met a reader; "ready": when told.
        fast: go as fast as the readers read.
        now_ns: the monotonic clock; a played one where nothing is real.

    Attributes:
        grain_s: for so long samples may gather in a device that sends by itself; a wake-up for each costs a
            processor.
    """

    grain_s = 0.0

    def __init__(
        self,
        sample_rate_hz: float,
        total: int | None,
        sources: Iterable[str],
        start: Literal["reader", "ready"],
        *,
        fast: bool = False,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.now_ns = now_ns
        self.sample_rate_hz = sample_rate_hz
        self.total = total
        self.fast = fast
        self.started = threading.Event()
        self.start_ns = 0
        self.start_wall_ns = 0
        self._by_reader = start == "reader"
        self._lock = threading.Lock()
        self._waiting = set(sources)
        self._taken = dict.fromkeys(self._waiting, 0)
        self._shown = 0

    def ready(self) -> None:
        """Tell that all devices can be read."""
        if not self._by_reader:
            self._begin()

    def meet(self, source: str) -> None:
        """Tell that a source has met a reader."""
        with self._lock:
            self._waiting.discard(source)
            begin = self._by_reader and not self._waiting
        if begin:
            self._begin()

    def unmet(self) -> tuple[str, ...]:
        """Return the sources that the start still waits for."""
        with self._lock:
            return tuple(sorted(self._waiting)) if self._by_reader else ()

    def _begin(self) -> None:
        with self._lock:
            if not self.started.is_set():
                self.start_ns = self.now_ns()
                self.start_wall_ns = time.time_ns()
                self.started.set()

    def head(self) -> int:
        """Return how many samples have been taken by now (in real time)."""
        if not self.started.is_set():
            return 0
        elapsed = self.now_ns() - self.start_ns
        # whole numbers where the rate is one: exact after any time
        rate = self.sample_rate_hz
        count = elapsed * int(rate) // NS if rate.is_integer() else int(elapsed * rate / NS)
        return self._bounded(count + 1)

    def take(self, source: str, taken: int) -> None:
        """Tell that a source's reader has taken its first `taken` samples."""
        with self._lock:
            self._taken[source] = taken

    def head_for(self, source: str, room: int) -> int:
        """Return how many samples a device may show that can hold `room` which its reader has not taken."""
        if not self.fast or not self.started.is_set():
            return self.head()
        with self._lock:
            head = self._bounded(min(self._taken[source] + room, min(self._taken.values()) + LAG_SAMPLES))
            self._shown = max(self._shown, head)
        return head

    def _bounded(self, count: int) -> int:
        return count if self.total is None else min(count, self.total)

    def due_ns(self, index: int) -> int:
        """Return when a sample is taken, monotonic ns."""
        return self.start_ns + round(index * NS / self.sample_rate_hz)

    def played(self) -> int:
        """Return how many samples have been played."""
        return self._shown if self.fast else self.head()

    def finished(self) -> bool:
        """Tell whether every sample has been played (and, played fast, taken)."""
        if self.total is None:
            return False
        with self._lock:
            slowest = min(self._taken.values(), default=self.total)
        return (slowest if self.fast else self.head()) >= self.total
