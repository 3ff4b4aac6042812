"""What is committed, to any number of listeners: one reader a database, cursors that survive a restart."""

import asyncio
import os
from collections import deque
from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from anyio.to_thread import run_sync

from agent.cli.tuning import ALIVE_S, COARSE_NS, MOST_BEHIND, PAGE_INSTANTS, RECENT_CHANGES, STREAM_POLL_S
from agent.clock import wall_ns
from agent.errors import StoreError
from agent.storage.database.files import beside
from agent.storage.read.recent import Change, Cursor, changes, newest

Stamp = tuple[int, ...]


class Position(tuple[Cursor, ...]):
    """How far somebody has read in each database; as text it is an event's id."""

    __slots__ = ()

    def __str__(self) -> str:
        return "~".join(map(str, self))

    @classmethod
    def read(cls, text: str, databases: int) -> Self | None:
        """Return the position that a text says; None where it is none of so many databases."""
        found = [
            cursor for part in text.split("~")[: databases + 1] if (cursor := Cursor.read(part)) is not None
        ]
        return cls(found) if len(found) == databases and text.count("~") == databases - 1 else None

    def moved(self, place: int, cursor: Cursor) -> Self:
        """Return the position with another cursor in one database."""
        return type(self)((*self[:place], cursor, *self[place + 1 :]))


@dataclass(frozen=True, slots=True)
class Event:
    """What a listener gets: kind "hello", "reset", "alarm", "estimates" or "alive", position, content."""

    kind: str
    position: Position
    place: int = 0
    change: Change | None = None


def stamp(path: Path) -> Stamp:
    """Return numbers that change with every commit to a database; all zero where it cannot be looked at."""
    return (*_stat(path), *_stat(beside(path, "-wal")))


def is_settled(seen: Stamp) -> bool:
    """Tell whether any later commit changes a stamp: the log may keep its size, and file times are coarse."""
    return wall_ns() - max(seen[2], seen[5]) > COARSE_NS


def _stat(path: Path) -> Stamp:
    try:
        seen = os.stat(path)  # noqa: PTH116 - asked five times a second
    except OSError:
        return (0, 0, 0)
    return seen.st_ino, seen.st_size, seen.st_mtime_ns


@dataclass(frozen=True, slots=True)
class _Look:
    """What was found: file, its stamp if settled, changes, the cursor after them, if the file is another."""

    file: int
    stamp: Stamp
    page: Sequence[Change]
    head: Cursor
    anew: bool = False


@dataclass(slots=True)
class _Tail:
    """The newest changes of one database, from the cursor `start` to the cursor `head`."""

    path: Path
    start: Cursor = field(default_factory=Cursor)
    head: Cursor = field(default_factory=Cursor)
    kept: deque[Change] = field(default_factory=deque)
    seen: Stamp = ()
    file: int = 0
    generation: int = 0

    def look(self) -> "_Look | None":
        """Read what was committed since, in any thread; None where nothing was. Raises StoreError."""
        now = stamp(self.path)
        if now == self.seen:
            return None
        known = now if is_settled(now) else ()
        if now[0] != self.file:  # another file in its place, as after a repair
            return _Look(now[0], known, [], newest(self.path), anew=True)
        return _Look(now[0], known, *changes(self.path, self.head, PAGE_INSTANTS))

    def take(self, look: "_Look") -> None:
        """Take in what was read; in the listeners' thread, so that none of them sees a part of it."""
        if look.anew:
            self.generation += bool(self.file)
            self.file = look.file
            self.start = self.head = look.head
            self.kept.clear()
            return
        if look.head == self.head:
            self.seen = look.stamp
        self.head = look.head
        self.kept.extend(look.page)
        while len(self.kept) > RECENT_CHANGES:
            self.start = _after(self.start, self.kept.popleft())

    def since(self, cursor: Cursor) -> list[Change] | None:
        """Return what came after a cursor; None where that is no longer kept here."""
        return [c for c in self.kept if _after(cursor, c) != cursor] if cursor.reaches(self.start) else None


def _after(cursor: Cursor, change: Change) -> Cursor:
    """Return the cursor of whoever was at one and has read a change; the same where it was read before."""
    if change.kind == "alarm":
        return cursor._replace(alarms=max(cursor.alarms, change.cursor.alarms))
    return cursor._replace(hops=max(cursor.hops, change.cursor.hops))


def _first_event(said: Position | None, now: Position) -> Event:
    """Return what a listener is greeted with: it goes on where it was, begins now, or has missed too much."""
    if said is None:
        return Event("hello", now)
    return Event("hello", said) if _can_resume(said, now) else Event("reset", now)


async def _is_idle(changed: asyncio.Event, *, quiet: bool) -> bool:
    """Wait for news where there were none; tell whether none came."""
    return quiet and not await _within(changed, ALIVE_S)


class Hub:
    """Reads databases while anybody listens or not; listeners wait for it and hold nothing of a file."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._tails = [_Tail(path) for path in paths]
        self._changed = asyncio.Event()
        self.listeners = 0

    async def run(self) -> None:
        """Read for ever, five times a second where something was committed; a failing file is tried again."""
        while True:
            news = [await _read(tail) for tail in self._tails]
            if any(news):
                self._changed.set()
                self._changed = asyncio.Event()
            await asyncio.sleep(0 if any(news) else STREAM_POLL_S)

    async def follow(self, said: Position | None) -> AsyncIterator[Event]:
        """Yield what is committed after a position, once and in order of each database and kind.

        Without a position, or with one from too long ago, it begins now.
        """
        now = Position([await _now(tail) for tail in self._tails])
        first = _first_event(said, now)
        position = first.position
        generation = self._generation()
        yield first
        while True:
            changed, before = self._changed, position
            for place, tail in enumerate(self._tails):
                page, end = await self._page(tail, position[place])
                for change in page:
                    position = position.moved(place, _after(position[place], change))
                    yield Event(change.kind, position, place, change)
                position = position.moved(place, end)
            if self._generation() != generation:
                return  # whoever comes again begins with the other file
            if await _is_idle(changed, quiet=position == before):
                yield Event("alive", position)

    async def _page(self, tail: _Tail, cursor: Cursor) -> tuple[list[Change], Cursor]:
        kept = tail.since(cursor)
        if kept is None:
            try:
                return await run_sync(changes, tail.path, cursor, PAGE_INSTANTS)
            except StoreError:
                return [], cursor
        ahead = Cursor(max(cursor.alarms, tail.head.alarms), max(cursor.hops, tail.head.hops))
        return kept, ahead

    def _generation(self) -> int:
        return sum(tail.generation for tail in self._tails)


async def _read(tail: _Tail) -> bool:
    """Bring a tail up to date; True where there is something new."""
    try:
        look = await run_sync(tail.look)
    except StoreError:  # it is tried again; whoever asks for rows is answered what is wrong
        return False
    before = tail.head
    if look is not None:
        tail.take(look)
    return tail.head != before


async def _now(tail: _Tail) -> Cursor:
    """Return the cursor of whoever has read all there is; of an unreadable file, all that was seen."""
    try:
        return await run_sync(newest, tail.path)
    except StoreError:
        return tail.head


def _can_resume(said: Position, now: Position) -> bool:
    pairs = list(zip(said, now, strict=True))
    return all(there.reaches(here) and there.hops - here.hops <= MOST_BEHIND for here, there in pairs)


async def _within(event: asyncio.Event, seconds: float) -> bool:
    try:
        await asyncio.wait_for(event.wait(), seconds)
    except TimeoutError:
        return False
    return True
