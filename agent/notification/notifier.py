"""A thread a target: it sends what the outbox holds for the target, in order, until the target has it.

It reads and marks through the database's single writer. One that hangs holds up nobody: not the writer, not
the other targets, not the end of the agent.
"""

import logging
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from agent.clock import wall_ns
from agent.config.sections.results import Notify
from agent.errors import AgentError
from agent.notification import tuning
from agent.notification.message import Message, message_of
from agent.notification.routing import quiet_s
from agent.notification.senders import SendError, send
from agent.storage.tables.notifications import NotificationRow
from agent.storage.write.jobs import Job
from agent.storage.write.notifications import Due, catch_up, due, note_done, note_failure
from agent.types import AlarmTransition

log = logging.getLogger(__name__)
Send = Callable[[Notify, Message, Path], None]


def _now() -> datetime:
    return datetime.fromtimestamp(wall_ns() / 1e9).astimezone()


class Notifier:
    """Keeps one target notified.

    Args:
        target: whom.
        folder: where the configuration's relative paths start.
        ask: has something done with the store, in its writer's thread.
        wanted: tells whether a step is for the target; what was done while no agent ran is caught up with by
            that.
        deliver: brings a message to the target.
        now: local time, for the quiet hours.
        pause_s: shortest and longest pause after a failed attempt.
    """

    def __init__(
        self,
        target: Notify,
        folder: Path,
        ask: Callable[[Job], Any],
        wanted: Callable[[AlarmTransition], bool] | None = None,
        deliver: Send = send,
        now: Callable[[], datetime] = _now,
        pause_s: tuple[float, float] = tuning.PAUSE_S,
    ) -> None:
        self.target = target
        self._folder, self._ask, self._deliver, self._now = folder, ask, deliver, now
        self._shortest_s, self._longest_s = pause_s
        self._wanted = wanted
        self._failures = 0
        self._delivered: deque[int] = deque(maxlen=tuning.REMEMBERED)
        self._due = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._work, name=f"notify-{target.name}", daemon=True)
        self.progress = 0
        """Grows with every round of the thread."""

    def start(self) -> None:
        self._thread.start()

    def wake(self) -> None:
        """Say that there may be something to send; from any thread."""
        self._due.set()

    def stop(self) -> None:
        """End the thread when it comes to it; an attempt under way is not awaited but retried if needed."""
        self._stopping.set()
        self._due.set()

    def _work(self) -> None:
        while not self._stopping.is_set():
            self._due.clear()
            self._pause(self._round_s())

    def _pause(self, seconds: float) -> None:
        """Wait; after a failure for the whole time, whatever news there are meanwhile."""
        waiting = self._stopping if self._failures else self._due
        waiting.wait(seconds)

    def _round_s(self) -> float:
        """Send what is due; return for how long to wait."""
        self.progress += 1
        try:
            return self._round()
        except (AgentError, sqlite3.Error, OSError) as error:
            log.info("%s: what is to be sent is not known now: %s", self.target.name, error)
            return tuning.STORE_S

    def _round(self) -> float:
        if self._wanted is not None:
            self._ask(partial(catch_up, target=self.target.name, wanted=self._wanted))
            self._wanted = None
        quiet = quiet_s(self.target, self._now())
        most = tuning.MESSAGES_QUIET if quiet else tuning.MESSAGES_AT_ONCE
        found: Sequence[Due] = self._ask(partial(due, target=self.target.name, most=most))
        # what a side file says of a row that was sent may not be in the file yet
        found = [one for one in found if one.row.seq not in self._delivered]
        for one in _urgent(found) if quiet else found:
            if self._stopping.is_set() or not self._sent(one):
                return self._back_off_s()
        if quiet:
            return min(quiet, tuning.IDLE_S)
        return 0.0 if len(found) == tuning.MESSAGES_AT_ONCE else tuning.IDLE_S

    def _sent(self, one: Due) -> bool:
        """Make one attempt and note what came of it; tell whether the next message may follow."""
        try:
            self._deliver(self.target, message_of(one.facts), self._folder)
        except SendError as error:
            return self._failed(one.row, str(error))
        self._failures = 0
        self._delivered.append(one.row.seq)
        self._noted(partial(note_done, row=one.row, t_ns=wall_ns()))
        return True

    def _noted(self, job: Job) -> None:
        """Have something noted, until it is: what is not would be sent again by the next run."""
        while True:
            try:
                self._ask(job)
                return
            except (AgentError, sqlite3.Error, OSError) as error:
                log.info("%s: what was sent cannot be noted now: %s", self.target.name, error)
            if self._stopping.wait(tuning.STORE_S):
                return

    def _failed(self, row: NotificationRow, words: str) -> bool:
        self._failures += 1
        dead = self._ask(partial(note_failure, row=row, error=words, most_attempts=self.target.attempts))
        if dead:
            self._failures = 0
            tried = f"given up after {row.attempts + 1} attempts"
            log.warning("%s: notification %d is %s: %s", self.target.name, row.seq, tried, words)
        elif self._failures == 1:
            log.warning(
                "%s: notification %d was not sent and is tried again: %s", self.target.name, row.seq, words
            )
        return bool(dead)

    def _back_off_s(self) -> float:
        return (
            min(self._longest_s, self._shortest_s * 2.0 ** min(self._failures - 1, 30))
            if self._failures
            else 0.0
        )


def _urgent(found: Sequence[Due]) -> Iterable[Due]:
    """Return what goes out in quiet hours: everything up to the last critical one, to keep the order."""
    places = [place for place, one in enumerate(found) if one.facts["priority"] == "critical"]
    return found[: places[-1] + 1] if places else ()
