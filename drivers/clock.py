"""The clock by which drivers wait, and whose lines they open: the machine's, or in one thread those of a played one.

Played time is no faster clock: it stands still while somebody computes, and moves when somebody waits. What a driver
does with it is then the same in every run.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from drivers.pipe import Pipe


class PlayedMachine(ABC):
    """A machine whose time and lines somebody plays."""

    @abstractmethod
    def monotonic_ns(self) -> int:
        """Return the time."""

    @abstractmethod
    def sleep(self, seconds: float) -> None:
        """Let time go by."""

    @abstractmethod
    def tcp(self, host: str, port: int) -> "Pipe":
        """Return a connection; DriverIOError when there is none to be had."""

    @abstractmethod
    def serial(self, device: str) -> "Pipe":
        """Return an open serial line; DriverIOError when it is not there."""


_PLAYED: ContextVar[PlayedMachine | None] = ContextVar("played", default=None)


@contextmanager
def playing(machine: PlayedMachine) -> Iterator[None]:
    """Let this thread's drivers live on a played machine."""
    token = _PLAYED.set(machine)
    try:
        yield
    finally:
        _PLAYED.reset(token)


def played() -> PlayedMachine | None:
    """Return the machine that is played to this thread; None on the real one."""
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
