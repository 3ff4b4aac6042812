"""A thread a consumer: sends what the consumer lacks, new rows first, and moves its cursors when it has them.

It reads through a read-only connection and stores cursors through the database's single writer. A consumer
that hangs, refuses or is gone holds up nobody: not the writer, not the other consumers, not the end of the
agent.
"""

import logging
import random
import sqlite3
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from agent.clock import monotonic_ns, wall_ns
from agent.config.sections.north import North
from agent.errors import AgentError
from agent.northbound.interface.peer import Batch, MakePeer, Peer, PeerError, Place
from agent.northbound.position import Position
from agent.northbound.tuning import FILL_S, KEEP_S, LATE_S, PAUSE_S, ROUND_S, STORE_S
from agent.records import HealthEvent
from agent.storage.read.forward import Feed, lag
from agent.storage.write.consumers.cursors import Edges, begin, edges_of, keep
from agent.storage.write.jobs import Job
from agent.storage.write.store import Store

_IN_ORDER: Final = ("alarms",)
_PERIOD: Final = "period"
"""The number under which a consumer by schedule keeps the period that it has."""

log = logging.getLogger(__name__)


class Forwarder:
    """Keeps one consumer supplied.

    Args:
        consumer: whom.
        place: of the database; what the peer asks of the agent is added here.
        make: makes a connection to the consumer.
        ask: has something done with the store, in its writer's thread.
        publish: makes an event of what became of the consumer.
        pause_s: shortest and longest pause after a failed attempt.
        late_s, keep_s: as LATE_S and KEEP_S.
    """

    def __init__(
        self,
        consumer: North,
        place: Place,
        make: MakePeer,
        ask: Callable[[Job], Any],
        publish: Callable[[Sequence[HealthEvent]], None],
        *,
        pause_s: tuple[float, float] = PAUSE_S,
        late_s: float = LATE_S,
        keep_s: float = KEEP_S,
    ) -> None:
        self.consumer = consumer
        self._make, self._ask, self._publish = make, ask, publish
        self._pause_s, self._late_s, self._keep_s = pause_s, late_s, keep_s
        self._feed = Feed(place.db, consumer.parameters)
        self._place = replace(
            place, newest=self._feed.newest, number=self._number, keep_number=self._keep_number,
            waiting=self._go_on,
            wake=self.wake,
        )  # fmt: skip
        self._peer: Peer | None = None
        self._positions: dict[str, Position] | None = None
        self._numbers: dict[str, int] = {}
        self._topics: tuple[str, ...] = consumer.topics
        self._behind_ns: dict[str, int] = dict.fromkeys(self._topics, -(2**62))
        """Since when the consumer is behind, by topic (monotonic); topics that are up to date are absent."""
        self._late_to: dict[str, int] = {}
        """Up to which number rows of topics that are sent in order come late."""
        self._is_kept = True
        self._kept_ns = self._failed_ns = monotonic_ns()
        self._failures = 0
        self._error: str | None = None
        self._due, self._stopping = threading.Event(), threading.Event()
        self._before: Forwarder | None = None
        self._is_forgotten = False
        self._share = consumer.at_once
        self._thread = threading.Thread(target=self._work, name=f"north-{consumer.name}", daemon=True)
        self.progress = 0
        """Grows with every round of the thread, and while it waits for its peer."""
        self.sent = 0
        """Rows that were acknowledged since the start."""
        self.retries = 0
        """Attempts that failed since the start."""

    def start(self, after: "Forwarder | None" = None) -> None:
        """Begin, when another that does the same has ended."""
        self._before = after
        self._thread.start()

    def is_alive(self) -> bool:
        """Tell whether the thread runs."""
        return self._thread.is_alive()

    def wake(self) -> None:
        """Say that there may be something to send; from any thread."""
        self._due.set()

    def stop(self, *, forget: bool = False) -> None:
        """End the thread when it comes to it; no attempt under way is waited for: it is made again if needed.

        forget: store no cursor any more, not even one that was acknowledged: the consumer is none any more.
        """
        self._is_forgotten = forget
        self._stopping.set()
        self._due.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the thread to end."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    @property
    def db(self) -> Path:
        """The database whose rows it brings."""
        return self._place.db

    def document(self, heads: Mapping[str, int] | None = None) -> dict[str, Any]:
        """Return the consumer as `deltak status` shows it.

        heads: how far its database's topics are, if that is known.
        """
        positions = dict(self._positions or {})
        is_ready = self._peer is not None or self.consumer.is_periodic  # one is not connected between periods
        return {
            "name": self.consumer.name, "kind": self.consumer.kind, "db": str(self._place.db),
            "state": "failing" if self._failures else "ok" if is_ready else "connecting",
            "error": self._error, "sent": self.sent, "retries": self.retries,
            "backfill": {topic: position.gap is not None for topic, position in positions.items()},
            "acknowledged": {topic: position.edges[0] for topic, position in positions.items()},
            "lag": {topic: lag(topic, position.lag(heads[topic]))
                    for topic, position in positions.items() if heads is not None},
        }  # fmt: skip

    def _work(self) -> None:
        while self._before is not None and self._before.is_alive() and self._go_on():
            self._before.join(0.5)
        self._before = None
        while not self._stopping.is_set():
            self._due.clear()
            self._pause(self._round_s())
        self._end()

    def _pause(self, seconds: float) -> None:
        """Wait; after a failure for the whole time, whatever news there are meanwhile."""
        waiting = self._stopping if self._failures else self._due
        while seconds > 0 and not waiting.wait(min(1.0, seconds)):
            self.progress += 1
            seconds -= 1.0

    def _go_on(self) -> bool:
        self.progress += 1
        return not self._stopping.is_set()

    def _round_s(self) -> float:
        """Send what is due; return for how long to wait."""
        self.progress += 1
        try:
            return self._round()
        except PeerError as error:
            return 0.0 if self._stopping.is_set() else self._failed(error)
        except (AgentError, sqlite3.Error, OSError) as error:
            log.info("%s: what is to be sent is not known now: %s", self.consumer.name, error)
            return STORE_S

    def _round(self) -> float:
        if self._positions is None:
            self._positions = self._restored()
        if self.consumer.is_periodic and not self._is_due():
            return min(ROUND_S, self._keep_in_s())
        if self._peer is None:
            peer = self._make(self.consumer, self._place)
            self._peer = peer
            peer.open()
        self._peer.check()
        heads = self._feed.reached(self._topics)
        is_behind = [self._send_new(topic, heads[topic]) for topic in self._topics]
        is_lacking = not any(is_behind) and self._fill()
        self._reached()
        if any(is_behind) or is_lacking:
            return 0.0
        if self.consumer.is_periodic:
            self._keep_number(_PERIOD, self._period())
            self._keep()
            self._leave()
        return max(0.05, min(ROUND_S, self._keep_in_s()))

    def _restored(self) -> dict[str, Position]:
        """Return how far the consumer has each topic; a new one begins with the oldest row, or the newest."""
        firsts = {topic: 0 if self.consumer.backfill else self._feed.head(topic) for topic in self._topics}
        edges: dict[str, Edges] = self._ask(partial(begin, name=self.consumer.name, firsts=firsts))
        self._is_kept = False  # from now on rows are kept for it
        self._kept_ns = -(2**62)
        return {topic: Position(one) for topic, one in edges.items()}

    def _is_due(self) -> bool:
        return self._number(_PERIOD) != self._period()

    def _period(self) -> int:
        """Return the number of the period that the wall clock is in."""
        return wall_ns() // round(self.consumer.every * 1e9)

    def _send_new(self, topic: str, head: int) -> bool:
        """Send what is new of a topic up to `head`, a batch; tell whether there may be more."""
        position = self._position(topic)
        if position.live >= head:
            return self._is_behind(topic, False)
        behind_s = (monotonic_ns() - self._behind_ns.get(topic, monotonic_ns())) / 1e9
        if not self.consumer.is_periodic and behind_s > self._late_s:
            position = self._left_behind(topic, position)
        late_to = self._late_to.get(topic, 0)
        is_late = position.live < late_to
        until = late_to if is_late else None
        chunk = self._feed.after(topic, position.live, until, self.consumer.at_once)
        is_through = until is not None and not chunk.more
        reached = late_to if is_through else chunk.reached
        self._deliver(Batch(topic, chunk.rows, position.live, backfill=is_late), position.advanced(reached))
        return self._is_behind(topic, any((is_late, chunk.more)))

    def _is_behind(self, topic: str, is_so: bool) -> bool:
        if is_so:
            self._behind_ns.setdefault(topic, monotonic_ns())
        else:
            self._behind_ns.pop(topic, None)
        return is_so

    def _left_behind(self, topic: str, position: Position) -> Position:
        """Go on with what is stored from now on; what is lacking until then is sent beside it.

        But for steps of alarms, which are few: the newest of one says its state only after those before it.
        """
        head = self._feed.head(topic)
        if topic in _IN_ORDER:
            self._late_to[topic] = head
        else:
            position = position.left_behind(head)
        self._note(topic, position)
        self._behind_ns.pop(topic, None)
        return position

    def _fill(self) -> bool:
        """Send a batch of what is lacking; tell whether there was any."""
        for topic in self._topics:
            position = self._position(topic)
            if position.gap is None:
                continue
            begun = monotonic_ns()
            chunk = self._feed.after(topic, *position.gap, self._share)
            after, until = position.gap
            position = position.filled(chunk.reached if chunk.more else until)
            self._deliver(Batch(topic, chunk.rows, after, backfill=True), position)
            self._adapt((monotonic_ns() - begun) / 1e9)
            return True
        return False

    def _adapt(self, seconds: float) -> None:
        """Choose how much is filled at once by how long the last took: what is new waits for it."""
        least, most = FILL_S
        if seconds > most:
            self._share = max(1, self._share // 2)
        elif seconds < least:
            self._share = min(self.consumer.at_once, 2 * self._share)

    def _position(self, topic: str) -> Position:
        assert self._positions is not None  # noqa: S101 - _round restored them
        return self._positions[topic]

    def _note(self, topic: str, position: Position) -> None:
        assert self._positions is not None  # noqa: S101 - _round restored them
        if position != self._positions[topic]:
            self._positions[topic] = position
            self._is_kept = False

    def _deliver(self, batch: Batch, position: Position) -> None:
        """Bring rows to the peer, if there are any, and note where that leaves it."""
        assert self._peer is not None  # noqa: S101 - _round made it
        if batch.rows:
            self._peer.deliver(batch)
            self.sent += len(batch.rows)
        self._note(batch.topic, position)
        if batch.rows:
            self._reached()

    def _reached(self) -> None:
        """Note that the peer answers, and store cursors if it is time."""
        if self._failures:
            seconds = (monotonic_ns() - self._failed_ns) / 1e9
            self._failures = 0
            self._error = None
            words = f"is reached again after {seconds:.1f} s; what it lacks is sent beside what is new"
            log.warning("%s: %s", self.consumer.name, words)
            self._tell("consumer recovered", words)
        if self._keep_in_s() <= 0:
            self._keep()

    def _keep_in_s(self) -> float:
        """Return in how many seconds cursors are to be stored; a long time where they are."""
        return ROUND_S if self._is_kept else self._keep_s - (monotonic_ns() - self._kept_ns) / 1e9

    def _keep(self) -> None:
        if self._positions is None:
            return
        positions = {topic: position.edges for topic, position in self._positions.items()}
        job = partial(self._stored, name=self.consumer.name, positions=positions, numbers=dict(self._numbers))
        self._kept_ns = monotonic_ns()
        lost = self._ask(job)
        self._is_kept = True
        if lost:
            words = (
                f"{lost} instants or rows were purged before it had them; the database had reached its bound"
            )
            log.warning("%s: %s", self.consumer.name, words)
            self._tell("purged unsent", words)

    def _stored(self, store: Store, **cursors: Any) -> int:
        """Store cursors, in the writer's thread, unless they were dropped for good."""
        return 0 if self._is_forgotten else keep(store, **cursors)

    def _number(self, key: str) -> int:
        if key not in self._numbers:
            found = self._ask(lambda store: edges_of(store.connection, self.consumer.name, key))
            self._numbers[key] = found[0] if found else 0
        return self._numbers[key]

    def _keep_number(self, key: str, number: int) -> None:
        self._numbers[key] = number
        self._is_kept = False

    def _failed(self, error: PeerError) -> float:
        """Leave the peer and say so once; return for how long to wait."""
        self._leave()
        self._failures += 1
        self.retries += 1
        self._error = f"{error.cause}: {error}"
        if self._failures == 1:
            self._failed_ns = monotonic_ns()
            self._behind_ns = dict.fromkeys(self._topics, self._failed_ns) | self._behind_ns
            words = f"cannot be supplied ({self._error}); rows wait in the database and it is tried again"
            log.warning("%s: %s", self.consumer.name, words)
            self._tell("consumer failed", words)
            self._keep_if_possible()
        shortest, longest = self._pause_s
        pause = min(longest, shortest * 2.0 ** min(self._failures - 1, 30))
        return pause * random.uniform(0.5, 1.0)  # noqa: S311 - so that many gateways do not come at once

    def _tell(self, cause: str, words: str) -> None:
        t_ns = wall_ns()
        source = self.consumer.name
        self._publish(
            [HealthEvent(rig, source, t_ns, cause, f"{source}: {words}") for rig in self._place.rigs]
        )

    def _leave(self) -> None:
        peer, self._peer = self._peer, None
        if peer is not None:
            peer.close()

    def _keep_if_possible(self) -> None:
        try:
            self._keep()
        except (AgentError, sqlite3.Error, OSError) as error:
            log.info("%s: its cursors cannot be stored now: %s", self.consumer.name, error)

    def _end(self) -> None:
        if not self._is_kept:
            self._keep_if_possible()
        self._leave()
        self._feed.close()
