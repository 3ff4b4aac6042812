"""Opening the databases of an agent, which may take minutes where one is large and damaged."""

import threading
from collections.abc import Callable, Iterable
from typing import Protocol

from agent.runtime.tuning import OPENING_LOOK_S


class Started(Protocol):
    """What is started, however long that takes."""

    def start(self) -> None:
        """Begin; raises where that can never work."""


class Opening(threading.Thread):
    """Starts writers in a thread of its own, so that an agent that is asked to end need not wait for it.

    What it leaves unfinished then is what a power cut would leave: the next start begins with it again.
    """

    def __init__(self, writers: Iterable[Started]) -> None:
        super().__init__(name="opening", daemon=True)
        self._writers = writers
        self._over = threading.Event()
        self._error: BaseException | None = None
        self.start()

    def run(self) -> None:
        """Start one writer after the other."""
        try:
            for writer in self._writers:
                writer.start()
        except BaseException as error:  # noqa: BLE001 - raised in the thread that waits
            self._error = error
        finally:
            self._over.set()

    def done(self, ended: Callable[[], bool]) -> bool:
        """Wait until all are started; False if the agent `ended` before. Raises what starting one raised."""
        while not self._over.wait(OPENING_LOOK_S):
            if ended():
                return False
        if self._error is not None:
            raise self._error
        return True
