"""One wrapper around every driver: opens, reads and re-opens it for ever, and says once what happened.

It never sleeps by itself beyond the time-out of `read`, and then on an event that stops it at once.
"""

import random
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drivers import clock
from drivers.port import Driver, DriverIOError, SampleBlock
from drivers.tuning import FIRST_S, RETRY_S

AWAY = frozenset({"lost", "stale", "bus-off"})
"""Causes that mean: no samples until "recovered"."""


@dataclass(frozen=True, slots=True)
class LinkEvent:
    """What happened to a source, once for each fault and once for each recovery.

    Attributes:
        cause: "lost" (cannot be opened or read), "stale" (open and silent), "recovered" (a sample came after
            either), or what the driver reports of its bus: "bus-off", which is away as well, "error-passive"
            and such.
        message: in words.
        at_s: when, on the wrapper's clock.
        kind: a short word for what a lost source died of ("timeout", "exception 2 ..."), where one is known.
    """

    cause: str
    message: str
    at_s: float
    kind: str = ""

    @property
    def away(self) -> bool:
        """Whether the source delivers nothing from here on."""
        return self.cause in AWAY


class Delivery(NamedTuple):
    """What a read brought: samples, and what happened to the source meanwhile, in order of time."""

    block: SampleBlock
    events: Sequence[LinkEvent]


class Backoff:
    """Pauses doubling from first_s to ceiling_s, each drawn from its upper half to keep rigs out of step."""

    def __init__(self, rng: random.Random, first_s: float = FIRST_S, ceiling_s: float = RETRY_S) -> None:
        self._rng = rng
        self._first_s = first_s
        self._ceiling_s = ceiling_s
        self._pause_s = first_s

    def next_s(self) -> float:
        """Return the pause before the next try."""
        pause_s = self._pause_s * self._rng.uniform(0.5, 1.0)
        self._pause_s = min(2.0 * self._pause_s, self._ceiling_s)
        return pause_s

    def reset(self) -> None:
        """Begin with the shortest pause again."""
        self._pause_s = self._first_s


class ReconnectingDriver:
    """Reads a driver through its faults.

    Args:
        driver: any driver; its counts go on over re-opens.
        stale_s: silence after which an open source counts as stale and is opened anew.
        clock: monotonic seconds.
        rng: draws the jitter of the pauses.
        stop: setting it ends every wait at once.

    DriverConfigError passes through, as retrying does not help, and so does the EOFError of a recording.
    """

    def __init__(
        self,
        driver: Driver,
        stale_s: float,
        *,
        clock: Callable[[], float] = clock.monotonic,
        rng: random.Random | None = None,
        stop: threading.Event | None = None,
    ) -> None:
        self.driver = driver
        self.is_open = False
        self._stale_s = stale_s
        self._clock = clock
        self._stop = stop or threading.Event()
        self._backoff = Backoff(rng or random.Random(), ceiling_s=driver.retry_s)  # noqa: S311 (jitter keeps no secret)
        self._retry_at = clock()
        self._received_at = clock()
        self._bad_before: Counter[str] = Counter()
        self._fault: str | None = None
        self._events: list[LinkEvent] = []

    def retry_in_s(self) -> float:
        """Return the seconds until the next try to open; 0 when open or due."""
        return 0.0 if self.is_open else max(0.0, self._retry_at - self._clock())

    def read(self, timeout_s: float) -> Delivery:
        """Return what has arrived and happened, opening the source first when that is due."""
        block = self._read_or_lose(timeout_s)
        events, self._events = self._events, []
        return Delivery(block, events)

    def _read_or_lose(self, timeout_s: float) -> SampleBlock:
        pause_s = self.retry_in_s()
        if pause_s > 0:
            clock.wait(self._stop, min(pause_s, timeout_s))
            return self._nothing()
        try:
            block = self._read_open(timeout_s)
        except DriverIOError as error:
            self._lose("lost", str(error), error.kind)
            return self._nothing()
        self._assess(len(block))
        self._pass_on()
        return block

    def close(self) -> None:
        """Close the source; `read` opens it again. Raises OSError where the driver does."""
        self.is_open = False
        self.driver.close()

    def _read_open(self, timeout_s: float) -> SampleBlock:
        if not self.is_open:
            self.driver.open()
            self.is_open = True
            self._receive(self._clock())
        return self.driver.read(timeout_s)

    def _assess(self, samples: int) -> None:
        now = self._clock()
        if samples:
            self._receive(now)
            self._backoff.reset()
            self._recover(now)
        elif now - self._received_at > self._stale_s and not self.driver.finite:
            self._lose("stale", f"{self.driver.request.name}: {self._silence()}")

    def _receive(self, now: float) -> None:
        self._received_at = now
        self._bad_before = self._bad()

    def _bad(self) -> Counter[str]:
        return self.driver.counts.rejected + self.driver.counts.faults

    def _silence(self) -> str:
        """Return what came instead of samples, in words: a line that talks rubbish is not silent."""
        bad = self._bad() - self._bad_before
        if not bad:
            return f"silent for {self._stale_s:g} s"
        reasons = ", ".join(f"{count} {reason}" for reason, count in bad.most_common(3))
        return f"no good sample for {self._stale_s:g} s: {reasons}"

    def _pass_on(self) -> None:
        """Make events of what the driver reports of its bus."""
        for cause, message in self.driver.take_reports():
            if cause in AWAY:
                if self._fault is not None:
                    continue
                self._fault = cause
            self._events.append(LinkEvent(cause, message, self._clock()))

    def _recover(self, now: float) -> None:
        if self._fault is not None:
            self._events.append(
                LinkEvent("recovered", f"{self.driver.request.name}: delivers samples again", now)
            )
            self._fault = None

    def _lose(self, cause: str, message: str, kind: str = "") -> None:
        """Close the source, plan the next try, and say so unless it is lost already."""
        with suppress(OSError):  # a device that is gone may refuse even that; it is lost either way
            self.close()
        now = self._clock()
        self._retry_at = now + self._backoff.next_s()
        if self._fault is None:
            self._fault = cause
            self._events.append(LinkEvent(cause, message, now, kind))

    def _nothing(self) -> SampleBlock:
        return SampleBlock(np.empty((0, len(self.driver.request.fields))), clock.monotonic_ns())
