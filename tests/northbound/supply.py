"""A writer with forwarders beside it, a consumer in memory that misbehaves by a script, and what a database
has."""

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.config.sections.north import North
from agent.northbound.forwarder import Forwarder
from agent.northbound.interface.peer import Batch, PeerError, Place
from agent.northbound.kinds import make_peer
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import run_info, select

SEQ_OF_ESTIMATES = """SELECT e.seq FROM hops h
 CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN fits f ON f.seq = e.fit_id WHERE h.span = 0 AND f.chosen = 1 ORDER BY e.seq"""


def numbers(path: Path) -> list[int]:
    return [seq for (seq,) in select(path, SEQ_OF_ESTIMATES)]


def events(path: Path) -> list[tuple[str, str]]:
    return select(
        path, "SELECT cause, message FROM v_events WHERE cause LIKE '%consumer%' OR cause LIKE '%unsent%'"
    )


@dataclass
class Archive:
    """A consumer: script says what becomes of each batch: "fine", "refused", "lost" (taken, unanswered),
    "hang"."""

    script: list[str] = field(default_factory=list)
    taken: list[tuple[str, int, bool]] = field(default_factory=list)
    closed: int = 0
    over: threading.Event = field(default_factory=threading.Event)
    before: Callable[[Batch], None] = lambda _: None

    def make(self, consumer: North, place: Place) -> "ArchivePeer":
        return ArchivePeer(self, place)

    def seqs(self, topic: str = "estimates", *, backfill: bool | None = None) -> list[int]:
        return [seq for where, seq, late in self.taken if where == topic and backfill in {None, late}]

    @property
    def doubles(self) -> int:
        return sum(count - 1 for count in Counter(self.taken).values())


@dataclass
class ArchivePeer:
    archive: Archive
    place: Place

    def open(self) -> None:
        if self.archive.script and self.archive.script[0] == "down":
            self.archive.script.pop(0)
            raise PeerError("refused", "nobody listens")

    def deliver(self, batch: Batch) -> None:
        self.archive.before(batch)
        fate = self.archive.script.pop(0) if self.archive.script else "fine"
        if fate in {"fine", "lost"}:
            self.archive.taken += [(batch.topic, row["seq"], batch.backfill) for row in batch.rows]
        if fate == "hang":
            while self.place.waiting() and not self.archive.over.wait(0.01):
                pass
        if fate != "fine":
            raise PeerError(fate, "scripted")

    def check(self) -> None:
        pass

    def close(self) -> None:
        self.archive.closed += 1


@contextmanager
def supplied(
    path: Path,
    consumers: Sequence[North],
    make: Any = make_peer,
    *,
    every_s: float = 0.0,
    period_s: float = 0.02,
    **settings: Any,
) -> Iterator[tuple[StoreWriter, list[Forwarder]]]:
    """Yield a writer whose rows go to consumers, and what forwards them."""
    settings = {"pause_s": (0.01, 0.05), "keep_s": 0.0} | settings
    writer = StoreWriter(
        lambda: Store.open(path), [run_info()], served=None, every_s=every_s, period_s=period_s
    )
    place = Place(path, path.parent, ("press-7",))
    forwarders = [Forwarder(one, place, make, writer.ask, writer.publish, **settings) for one in consumers]

    def wake() -> None:
        for forwarder in forwarders:
            forwarder.wake()

    writer.on_stored = wake
    writer.start()
    for forwarder in forwarders:
        forwarder.start()
    try:
        yield writer, forwarders
    finally:
        for forwarder in forwarders:
            forwarder.stop()
        for forwarder in forwarders:
            forwarder.join(5)
        writer.stop()
