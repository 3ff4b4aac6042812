"""What waits for a rig's turn to compute, for how long, and what became of it where the agent ended first."""

from collections import Counter, deque
from collections.abc import Iterator

from agent.records import HealthEvent, Record
from agent.runtime.sources import Arrival, Connection, Use
from agent.runtime.tuning import BEGINNING_NS, BEGINNING_RAISE_NS, CLEAR_NS, PART, RAISE_NS
from agent.types import COMPUTING, AlarmTransition
from drivers.port import Counts
from drivers.reconnect import LinkEvent

STOPPED = "stopped"
"""Reason of samples that were received and not computed any more when the agent ended."""


class Waiting:
    """Blocks and events of one rig's sources, in the order in which they are to be taken.

    Attributes:
        taken: the newest block of each source that had its turn.
    """

    def __init__(self) -> None:
        self.taken: dict[str, Arrival] = {}
        self._queue: deque[tuple[Use, Arrival | LinkEvent]] = deque()
        self._dropped: dict[str, Counter[str]] = {}

    def __bool__(self) -> bool:
        return bool(self._queue)

    def add(self, use: Use, what: Arrival | LinkEvent) -> None:
        """Let a block or an event wait behind the others."""
        self._queue.append((use, what))

    @property
    def oldest_ns(self) -> int | None:
        """When the oldest block that waits arrived, monotonic; None where none does."""
        return next((what.block.arrival_ns for _, what in self._queue if isinstance(what, Arrival)), None)

    def part(self) -> Iterator[tuple[Use, Arrival | LinkEvent]]:
        """Take what comes first, until its samples are about PART."""
        room = PART
        while self._queue and room > 0:
            use, what = self._queue.popleft()
            if not isinstance(what, LinkEvent):
                room -= len(what.block)
                self.taken[use.source] = what
            yield use, what

    def drop(self) -> list[tuple[Use, LinkEvent]]:
        """Drop and count the samples that wait; return the events."""
        events = []
        while self._queue:
            use, what = self._queue.popleft()
            if isinstance(what, LinkEvent):
                events.append((use, what))
            else:
                self._dropped.setdefault(use.source, Counter())[STOPPED] += len(what.block)
        return events

    def counts(self, use: Use, connection: Connection) -> tuple[Counts, Counter[str]]:
        """Return a source driver's counts up to the newest block that does not wait, and those dropped since.

        So the ledger balances at any time.
        """
        source = use.source
        dropped = use.dropped(connection.dropped) + self._dropped.get(source, Counter())
        if not any(other.source == source and isinstance(what, Arrival) for other, what in self._queue):
            return use.counts(connection.counts), dropped
        return self.taken[source].counts if source in self.taken else Counts(), dropped


BEHIND = "behind"
"""What the event is called."""


class Lateness:
    """How long the samples of one rig wait to be computed.

    standing: the alarm that says so stands.
    """

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._least_ns: int | None = None
        self._begun_ns: int | None = None
        self.standing = False

    def step(self, waited_ns: int, t_ns: int, now_ns: int) -> list[Record]:
        """Take how long the oldest sample has waited now (monotonic); return what is to be told at t_ns.

        The least that any waited is no backlog: it is what handing over takes, or clocks that do not agree.
        Nor is it a fault that many rigs which begin together learn their first windows one after another.
        """
        self._begun_ns = now_ns if self._begun_ns is None else self._begun_ns
        self._least_ns = waited_ns if self._least_ns is None else min(self._least_ns, waited_ns)
        late_ns = waited_ns - self._least_ns
        if self.standing == (late_ns > self._bound_ns(now_ns)):
            return []
        self.standing = not self.standing
        state = (
            f"computing is {late_ns / 1e9:.1f} s behind its samples"
            if self.standing
            else "computing keeps up again"
        )
        words = f"{self._rig}: {state}"
        cause = BEHIND if self.standing else "recovered"
        alarm = AlarmTransition.plain(self._rig, "source", COMPUTING, t_ns, words, stands=self.standing)
        return [HealthEvent(self._rig, COMPUTING, t_ns, cause, words), alarm]

    def _bound_ns(self, now_ns: int) -> int:
        """Return the lateness at which something is to be told now."""
        if self.standing:
            return CLEAR_NS
        begins = now_ns - (self._begun_ns or now_ns) < BEGINNING_NS
        return BEGINNING_RAISE_NS if begins else RAISE_NS
