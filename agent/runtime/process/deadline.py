"""An end to computing, whatever is being computed."""

import ctypes
import threading
import time
from collections.abc import Callable

from agent.runtime.tuning import ON_ITS_WAY_S


class OverdueError(BaseException):
    """Raised amid computing when the time is over; like KeyboardInterrupt it passes `except Exception`."""


class Deadline:
    """Breaks off what one thread computes once the time is over, and refuses to begin anything then."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside: int | None = None
        self._raised = False
        self._timers: list[threading.Timer] = []
        self.over = False

    def in_s(self, seconds: float) -> None:
        """See that computing ends after so many seconds."""
        timer = threading.Timer(seconds, self._end)
        timer.daemon = True
        timer.start()
        self._timers.append(timer)

    def end(self) -> None:
        """Break nothing off any more."""
        for timer in self._timers:
            timer.cancel()

    def within(self, act: Callable[[], object]) -> bool:
        """Do something unless the time is over; False where it was not begun, or broken off half done."""
        try:
            if not self._enter():
                return False
            try:
                act()
            except Exception:
                self._leave()
                raise
            self._leave()
        except OverdueError:
            return False
        return True

    def _enter(self) -> bool:
        with self._lock:
            self._inside = None if self.over else threading.get_ident()
            return not self.over

    def _leave(self) -> None:
        with self._lock:
            self._inside = None
        until = time.monotonic() + ON_ITS_WAY_S
        while self._raised and time.monotonic() < until:  # it must not come where nothing expects it
            time.sleep(0.001)

    def _end(self) -> None:
        """Raise in the thread that computes, as signals do: between two of its instructions."""
        with self._lock:
            self.over = True
            if self._inside is not None and not self._raised:
                self._raised = True
                thread = ctypes.c_ulong(self._inside)
                ctypes.pythonapi.PyThreadState_SetAsyncExc(thread, ctypes.py_object(OverdueError))
