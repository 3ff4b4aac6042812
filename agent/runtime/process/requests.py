"""Signals as requests: done by a thread that is there already, once for all that came while it was busy."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from signal import SIG_UNBLOCK, Signals, pthread_sigmask, signal
from threading import Thread
from types import FrameType

log = logging.getLogger(__name__)


class Request:
    """A signal's handler. It interrupts the thread that may hold the very lock that acting takes.

    What a handler may do at any moment is to put into a SimpleQueue; a thread made there would be refused
    where all tasks of the service are used (TasksMax), and end the agent. What comes before `begin` waits.

    Args:
        name: the name of the thread that acts.
    """

    def __init__(self, name: str) -> None:
        self._act: Callable[[], object] = int
        self._came: SimpleQueue[bool] = SimpleQueue()
        self._thread = Thread(target=self._work, name=name, daemon=True)

    def begin(self, act: Callable[[], object]) -> None:
        """Do what is asked for from now on; asked for while it is done, it is done once more."""
        self._act = act
        self._thread.start()

    def __call__(self, _number: int, _frame: FrameType | None) -> None:
        """Have it done."""
        self._came.put(True)

    def end(self) -> None:
        """End the thread when it comes to it."""
        self._came.put(False)

    def _work(self) -> None:
        while self._is_asked():
            try:
                self._act()
            except Exception as error:
                log.exception("%s: %s", self._thread.name, type(error).__name__)

    def _is_asked(self) -> bool:
        """Wait until something came; take all of it, and tell whether the thread is to go on."""
        goes_on = self._came.get()
        while not self._came.empty():
            goes_on &= self._came.get()
        return goes_on


@contextmanager
def asked_by(number: Signals, name: str) -> Iterator[Request]:
    """Have a signal be a request inside; nobody is ended by it. One that was held until now is the first."""
    request = Request(name)
    previous = signal(number, request)
    pthread_sigmask(SIG_UNBLOCK, {number})
    try:
        yield request
    finally:
        signal(number, previous)
        request.end()
