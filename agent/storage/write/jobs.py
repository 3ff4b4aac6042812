"""What other threads want done with the store: done in the writer's thread, between two of its commits."""

from collections.abc import Callable
from concurrent.futures import Future
from queue import Empty, SimpleQueue
from typing import Any

from agent.errors import StoreError
from agent.storage.write.store import Store

Job = Callable[[Store], Any]


class JobQueue:
    """A queue of jobs; each caller waits for its own. wake: called when one has come."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._waiting: SimpleQueue[tuple[Job, Future[Any]]] = SimpleQueue()
        self._over = False

    def __bool__(self) -> bool:
        return not self._waiting.empty()

    def ask(self, job: Job) -> Any:
        """Have something done with the store; returns what it returns, and raises what it raises.

        Raises:
            StoreError: the store cannot be written at present, or the agent is ending.
        """
        answer: Future[Any] = Future()
        self._waiting.put((job, answer))
        if self._over:
            self.refuse("its agent is ending", "ask again when it has ended")
        self._wake()
        return answer.result()

    def run(self, store: Store) -> None:
        """Do what was asked for."""
        for job, answer in self._taken():
            try:
                answer.set_result(job(store))
            except Exception as error:  # noqa: BLE001 - the caller gets it; the writer goes on
                answer.set_exception(error)

    def refuse(self, message: str, advice: str) -> None:
        """Tell everybody who waits that it cannot be done."""
        for _, answer in self._taken():
            answer.set_exception(StoreError.at("its agent", message, advice))

    def end(self) -> None:
        """Refuse what waits, and what may still come."""
        self._over = True
        self.refuse("its agent is ending", "ask again when it has ended")

    def _taken(self) -> list[tuple[Job, "Future[Any]"]]:
        taken = []
        try:
            while True:
                taken.append(self._waiting.get_nowait())
        except Empty:
            return taken
