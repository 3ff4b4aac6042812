"""A link between two processes of an agent: each says and asks for things without waiting for the other.

What passes is pickled; both ends are the same program, run by the same user, joined by a pair of sockets.
"""

import logging
import os
import pickle
import socket
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from itertools import count
from multiprocessing.connection import Connection
from typing import Any

from agent.errors import AgentError
from agent.runtime.tuning import MOST_SPARE

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Tell:
    """Something said, to which nothing is answered."""

    what: str
    given: Any


@dataclass(frozen=True, slots=True)
class Ask:
    """Something asked for; the answer bears its number."""

    number: int
    what: str
    given: Any


@dataclass(frozen=True, slots=True)
class Answer:
    """What was asked for, or why it is refused."""

    number: int
    value: Any
    error: BaseException | None = None


Message = Tell | Ask | Answer


class Link:
    """One end of a link, with a thread that sends and one that receives.

    Args:
        connection: the socket.
        name: of the threads.
        hears: by what is said: takes what is given with it, in the receiving thread.
        answers: by what is asked for: returns the answer, in a thread of its own.
        over: called when the other end is gone.
    """

    def __init__(
        self,
        connection: Connection,
        name: str,
        hears: Mapping[str, Callable[[Any], object]],
        answers: Mapping[str, Callable[[Any], Any]],
        over: Callable[[], None],
    ) -> None:
        self._connection, self._name, self._over = connection, name, over
        self._hears, self._answers = hears, answers
        self._condition = threading.Condition()
        self._waiting: deque[Callable[[], Message | None]] = deque()
        self._asked: dict[int, Future[Any]] = {}
        self._numbers = count(1)
        self._sending = self._ended = False

    def start(self) -> None:
        """Begin to send and to receive."""
        for act, what in ((self._send_all, "sends"), (self._receive_all, "hears")):
            threading.Thread(target=act, name=f"{self._name} {what}", daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether the other end is gone."""
        return self._ended

    def tell(self, what: str, given: Any = None, *, spare: bool = False) -> None:
        """Say something; never waits. spare: it need not arrive where much else waits to be sent."""
        if not (spare and len(self._waiting) > MOST_SPARE):
            self.post(lambda: Tell(what, given))

    def post(self, make: Callable[[], Message | None]) -> None:
        """Have a message made and sent after all that waits; never waits."""
        with self._condition:
            if not self._ended:
                self._waiting.append(make)
                self._condition.notify_all()

    def ask(self, what: str, given: Any = None) -> "Future[Any]":
        """Ask for something; the answer fails with AgentError where the other end is gone."""
        answer: Future[Any] = Future()
        with self._condition:
            number = next(self._numbers)
            self._asked[number] = answer
        self.post(lambda: Ask(number, what, given))
        if self._ended:
            self._refuse_all()
        return answer

    def drain(self, timeout_s: float) -> bool:
        """Wait until all is sent; False where that takes longer."""
        with self._condition:
            return self._condition.wait_for(
                lambda: self._ended or not (self._waiting or self._sending), timeout_s
            )

    def close(self) -> None:
        """Close this end; the other one sees it, and so does the thread that receives here."""
        with suppress(OSError), socket.socket(fileno=os.dup(self._connection.fileno())) as peer:
            peer.shutdown(socket.SHUT_RDWR)

    # --- the sending thread ---------------------------------------------------------------------------------

    def _send_all(self) -> None:
        while (make := self._next()) is not None:
            message = make()
            if message is None:
                continue
            try:
                self._connection.send_bytes(_packed(message))
            except (OSError, ValueError):  # the receiving thread sees to the end
                return

    def _next(self) -> Callable[[], Message | None] | None:
        with self._condition:
            self._sending = False
            self._condition.notify_all()
            self._condition.wait_for(lambda: self._waiting or self._ended)
            if not self._waiting:
                return None
            self._sending = True
            return self._waiting.popleft()

    # --- the receiving thread -------------------------------------------------------------------------------

    def _receive_all(self) -> None:
        try:
            while True:
                self._receive(pickle.loads(self._connection.recv_bytes()))  # noqa: S301 - of this program, see above
        except (EOFError, OSError):
            log.debug("%s: the other end is gone", self._name)
        finally:
            with self._condition:
                self._ended = True
                self._condition.notify_all()
            self._connection.close()
            self._refuse_all()
            self._over()

    def _receive(self, message: Message) -> None:
        if isinstance(message, Tell):
            self._take(message)
        elif isinstance(message, Ask):
            threading.Thread(target=self._answer, args=(message,), name=message.what, daemon=True).start()
        else:
            _settle(self._asked.pop(message.number), message)

    def _take(self, said: Tell) -> None:
        try:
            self._hears[said.what](said.given)
        except Exception:
            # what one message does wrong must not cut off all others
            log.exception("%s: %s was not taken", self._name, said.what)

    def _answer(self, asked: Ask) -> None:
        try:
            answer = Answer(asked.number, self._answers[asked.what](asked.given))
        except Exception as error:  # noqa: BLE001 - the asker is told
            answer = Answer(asked.number, None, error)
        self.post(lambda: answer)

    def _refuse_all(self) -> None:
        while self._asked:
            with suppress(KeyError):
                _, waiting = self._asked.popitem()
                waiting.set_exception(AgentError.at("worker", "the process ended", "see the log"))


def _settle(waiting: "Future[Any]", answer: Answer) -> None:
    if answer.error is None:
        waiting.set_result(answer.value)
    else:
        waiting.set_exception(answer.error)


def _packed(message: Message) -> bytes:
    try:
        return pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    except Exception as error:
        if not isinstance(message, Answer):
            raise
        words = f"{type(message.error or message.value).__name__}: {message.error or error}"
        return pickle.dumps(Answer(message.number, None, RuntimeError(words)), pickle.HIGHEST_PROTOCOL)
