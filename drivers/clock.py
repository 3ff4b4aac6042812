"""The clock by which drivers wait, and whose lines they open: the machine's, or in one thread a played one's.

Played time is no faster clock: it stands still while somebody computes, and moves when somebody waits. What a
driver does with it is then the same in every run.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class PlayedTime(ABC):
    """The time of a machine that somebody plays; `drivers.pipe` adds its lines."""

    @abstractmethod
    def monotonic_ns(self) -> int:
        """Return the time."""

    @abstractmethod
    def sleep(self, seconds: float) -> None:
        """Let time go by."""


_PLAYED: ContextVar[PlayedTime | None] = ContextVar("played", default=None)


@contextmanager
def playing(machine: PlayedTime) -> Iterator[None]:
    """Let this thread's drivers live on a played machine."""
    token = _PLAYED.set(machine)
    try:
        yield
    finally:
        _PLAYED.reset(token)


def played() -> PlayedTime | None:
    """Return the time of the machine that is played to this thread; None on the real one."""
    return _PLAYED.get()


def monotonic_ns() -> int:
    """Return the monotonic clock, ns."""
    machine = _PLAYED.get()
    return time.monotonic_ns() if machine is None else machine.monotonic_ns()


def monotonic() -> float:
    """Return the monotonic clock, s."""
    machine = _PLAYED.get()
    return time.monotonic() if machine is None else machine.monotonic_ns() / 1e9


def sleep(seconds: float) -> None:
    """Wait."""
    machine = _PLAYED.get()
    if machine is None:
        time.sleep(seconds)
    else:
        machine.sleep(seconds)


def wait(event: threading.Event, seconds: float) -> None:
    """Wait until an event is set, at most so long."""
    machine = _PLAYED.get()
    if machine is None:
        event.wait(seconds)
    elif not event.is_set():
        machine.sleep(seconds)
