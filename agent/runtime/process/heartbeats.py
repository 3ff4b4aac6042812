"""Heartbeats: whether every thread of the agent makes progress, and which does not."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple


class Thread(NamedTuple):
    """What one thread says of itself.

    Attributes:
        name: what status, metrics and the log call it.
        progress: grows with every turn of the thread.
        alive: whether it runs; one that has ended is seen elsewhere (an alarm of its source, an exit of the
            agent).
        patience: for how many watchdog intervals it may be silent.
    """

    name: str
    progress: int
    alive: bool = True
    patience: float = 1.0


@dataclass(slots=True)
class Beat:
    """State of one thread: its progress, when that last grew (monotonic, ns), for how long it has not, s."""

    progress: int
    last_ns: int
    silent_s: float = 0.0
    allowed_s: float = 0.0
    alive: bool = True

    @property
    def stalled(self) -> bool:
        """Whether it has been silent for longer than it may."""
        return self.alive and self.silent_s > self.allowed_s


class Heartbeats:
    """The threads of an agent, looked at once a period.

    Silence is the sum of the periods in which a thread made no progress, without the time in which the
    machine left the agent no processor, and each counted as two periods at most: where the whole agent goes
    hungry, whoever looks is late too, and no thread is at fault.

    Args:
        threads: the threads that there are now.
        interval_s: the watchdog's interval, by which patience is measured.
        period_s: how often `look` is called.
        waited_s: returns how long since it was called last the agent could have run and was not let.
    """

    def __init__(
        self,
        threads: Callable[[], Iterable[Thread]],
        interval_s: float,
        period_s: float,
        waited_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._threads, self._interval_s, self._period_s = threads, interval_s, period_s
        self._waited_s = waited_s
        self._looked_ns: int | None = None
        self.beats: dict[str, Beat] = {}

    def look(self, now_ns: int) -> list[str]:
        """Note every thread's progress at a monotonic instant; return the names of those that stall."""
        passed_s = 0.0 if self._looked_ns is None else (now_ns - self._looked_ns) / 1e9
        self._looked_ns = now_ns
        counted_s = min(max(0.0, passed_s - self._waited_s()), 2 * self._period_s)
        self.beats = {thread.name: self._beat(thread, now_ns, counted_s) for thread in self._threads()}
        return [name for name, beat in self.beats.items() if beat.stalled]

    def _beat(self, thread: Thread, now_ns: int, counted_s: float) -> Beat:
        allowed_s = thread.patience * self._interval_s
        before = self.beats.get(thread.name)
        if before is None or before.progress != thread.progress:
            return Beat(thread.progress, now_ns, 0.0, allowed_s, thread.alive)
        return Beat(thread.progress, before.last_ns, before.silent_s + counted_s, allowed_s, thread.alive)
