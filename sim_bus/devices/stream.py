"""Samples that a device sends by itself: when they are due, to whom, and how late they went."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from sim_bus.clock import NS, PlayClock
from sim_bus.devices.wire import Feed
from sim_bus.rig.faults import LineFaults
from sim_bus.rig.ranges import Runs
from sim_bus.tuning import FAST_ROOM, IDLE_S, LATE_REMEMBERED

Encode = Callable[[int, bytes], bytes]
"""Makes what goes over a line from a sample's number and row."""


class Lateness:
    """How late samples went out: the whole run's extremes, and the spread of the newest 100 000."""

    def __init__(self, period_ns: float) -> None:
        self._period_ns = period_ns
        self._newest: deque[int] = deque(maxlen=LATE_REMEMBERED)
        self._late = 0
        self._worst = 0
        self._count = 0

    def note(self, late_ns: int) -> None:
        """Add one wake-up: how long after its due time its oldest sample went out."""
        self._newest.append(late_ns)
        self._count += 1
        self._late += late_ns > self._period_ns
        self._worst = max(self._worst, late_ns)

    def summary(self) -> dict[str, float]:
        """Return wake-ups, those later than a sample period, and the lateness in µs."""
        middle, most = np.percentile(list(self._newest) or [0], [50, 99]) / 1000.0
        return {
            "wake_ups": self._count,
            "late": self._late,
            "p50_us": round(float(middle), 1),
            "p99_us": round(float(most), 1),
            "max_us": round(self._worst / 1000.0, 1),
        }


class Outlet(ABC):
    """Somebody who is sent samples, or a line; keeps at most `limit` bytes the other side does not take."""

    limit = 1 << 20

    def __init__(self) -> None:
        self._waiting = bytearray()
        self.gone = False

    @property
    def pending(self) -> int:
        """Bytes not sent yet."""
        return len(self._waiting)

    def put(self, data: bytes) -> bool:
        """Keep data for sending; False, and nothing is kept, when too much waits already."""
        if len(self._waiting) + len(data) > self.limit:
            return False
        self._waiting += data
        return True

    def flush(self) -> None:
        """Send what the other side takes now."""
        while self._waiting and not self.gone:
            sent = self._send(bytes(self._waiting[: 1 << 16]))
            del self._waiting[:sent]
            if not sent:
                return

    def forget(self) -> None:
        """Throw away what waits."""
        self._waiting.clear()

    @abstractmethod
    def _send(self, data: bytes) -> int:
        """Send without waiting; return how many bytes went. Sets `gone` when the other side is."""


class Stream:
    """One source's samples on their way to outlets.

    Args:
        source: its name.
        feed: its samples as rows.
        clock: says which of them have been taken.
        encode: makes what goes over the line.
        faults: what goes wrong on the line.
    """

    def __init__(self, source: str, feed: Feed, clock: PlayClock, encode: Encode, faults: LineFaults) -> None:
        self.source = source
        self.outlets: list[Outlet] = []
        self._feed = feed
        self._clock = clock
        self._encode = encode
        self._faults = faults
        self._next = 0
        self._frames = 0
        self._unheard = Runs()
        self._overflow = Runs()
        self._lateness = Lateness(1e9 / clock.sample_rate_hz)

    def add(self, outlet: Outlet) -> None:
        """Begin to send to an outlet."""
        self.outlets.append(outlet)
        self._clock.meet(self.source)

    @property
    def disconnected(self) -> bool:
        """Whether the line is to be gone at this time."""
        return self._clock.started.is_set() and self._faults.at_time("disconnect", self._clock.played() - 1)

    def step(self) -> None:
        """Hand the samples that are due to the outlets, and send what they take."""
        self.outlets = [outlet for outlet in self.outlets if not outlet.gone]
        head = self._fast_head() if self._clock.fast else self._clock.head_for(self.source, 0)
        if head > self._next:
            self._emit(self._next, head)
            self._next = head
        for outlet in self.outlets:
            outlet.flush()
        if self._clock.fast and not any(outlet.pending for outlet in self.outlets):
            self._clock.take(self.source, self._next)

    def _fast_head(self) -> int:
        received = self.outlets and not any(outlet.pending for outlet in self.outlets)
        return self._clock.head_for(self.source, FAST_ROOM) if received else self._next

    def _emit(self, first: int, end: int) -> None:
        if not self._clock.fast:
            self._lateness.note(self._clock.now_ns() - self._clock.due_ns(first))
        if not self.outlets:
            self._unheard.add(first, end - 1)
            return
        for number, row in enumerate(self._feed.rows(first, end), first):
            data = self._faults.apply(number, self._encode(number, row))
            taken = [outlet.put(data) for outlet in self.outlets]
            if all(taken):
                self._frames += 1
            else:
                self._overflow.add(number, number)

    def wait_s(self) -> float:
        """Return for how long nothing is due."""
        if any(outlet.pending for outlet in self.outlets):
            return 0.001
        if not self._clock.started.is_set():
            return IDLE_S / 10
        if self._clock.fast:
            return 0.0 if self.outlets and not self._clock.finished() else IDLE_S / 10
        if self._clock.total is not None and self._next >= self._clock.total:
            return IDLE_S
        due_s = (self._clock.due_ns(self._next) - self._clock.now_ns()) / 1e9
        return min(IDLE_S, max(0.0, due_s + self._clock.grain_s))

    def next_due_ns(self) -> int:
        """Return when the next sample is taken; never comes what lies beyond the end."""
        if self._clock.total is not None and self._next >= self._clock.total:
            return self._clock.now_ns() + NS
        return self._clock.due_ns(self._next)

    def ledger(self) -> dict[str, Any]:
        """Return what was sent, to whom it did not come, and how late."""
        played = self._clock.played()
        return {
            "sent": self._frames,
            "unheard": self._unheard.before(played),
            "lost": self._overflow.before(played),
            "absent": self._absent(played),
            "lateness": self._lateness.summary(),
            "saturated": self._feed.saturated(played),
            "faults": self._faults.ledger(played),
        }

    def _absent(self, played: int) -> list[tuple[int, int]]:
        """Return the samples that no reader got whole and in order."""
        absent = Runs()
        gone = {number for number in self._faults.gone | self._faults.hidden if number < played}
        gone |= self._unheard.numbers(played) | self._overflow.numbers(played)
        absent.add_each(np.array(sorted(gone), dtype=np.int64))
        return absent.before(played)
