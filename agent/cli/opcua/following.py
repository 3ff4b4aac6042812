"""What is committed, once a second, into the address space: overview rows, and each step of each alarm."""

import asyncio
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from agent.cli.glance.files import Watched
from agent.cli.glance.state import overview
from agent.cli.opcua.conditions import Conditions
from agent.cli.opcua.space import Space
from agent.cli.tuning import EVERY_S, PAGE_CHANGES
from agent.clock import wall_ns
from agent.errors import StoreError
from agent.storage.read.recent import Change, Cursor, changes, newest

log = logging.getLogger(__name__)
_NO_ROWS: Final = 10**18 - 1
"""Fixed by its meaning: a cursor so far ahead that rows are not read: they come by the overview, the newest
only: a cursor so far ahead that rows of estimates are not read: those come by the overview, the newest
only."""


@dataclass(slots=True)
class _Look:
    """What one look at a database found: rigs, alarm steps, the cursor after them, if it is the first."""

    rigs: Sequence[Mapping[str, Any]]
    steps: list[Change]
    cursor: Cursor
    is_first: bool


@dataclass(slots=True)
class Following:
    """Reads the databases and writes the space, until it is cancelled; a file that fails is tried again.

    Attributes:
        news: set it to have it look at once.
    """

    databases: Sequence[Watched]
    space: Space
    conditions: Conditions
    news: asyncio.Event = field(default_factory=asyncio.Event)
    _cursors: dict[str, Cursor] = field(default_factory=dict)
    _failed: set[str] = field(default_factory=set)

    async def run(self) -> None:
        """Look for ever, each second and when there is news."""
        while True:
            await self.look()
            try:
                await asyncio.wait_for(self.news.wait(), EVERY_S)
            except TimeoutError:
                continue
            self.news.clear()

    async def look(self) -> None:
        """Take in what was committed since, of each database."""
        for database in self.databases:
            try:
                found = await asyncio.to_thread(self._read, database)
            except StoreError as error:
                if database.name not in self._failed:
                    log.warning("%s", error)
                self._failed.add(database.name)
                continue
            self._failed.discard(database.name)
            await self._take(database.name, found)

    def _read(self, database: Watched) -> _Look:
        """Read a database, in any thread. Raises StoreError."""
        after = self._cursors.get(database.name)
        now = Cursor(newest(database.path).alarms, _NO_ROWS)
        is_first = after is None or not now.reaches(
            after
        )  # another file stands in its place, as after a repair
        if after is None or is_first:
            return _Look(overview([database], wall_ns())["rigs"], [], now, is_first)
        steps: list[Change] = []
        while after != now:
            page, after = changes(database.path, after, PAGE_CHANGES)
            steps += page
            now = now if now.reaches(after) else after
        return _Look(overview([database], wall_ns())["rigs"], steps, after, is_first)

    async def _take(self, db: str, found: _Look) -> None:
        self._cursors[db] = found.cursor
        now_ns = wall_ns()
        for rig in found.rigs:
            await self.space.rig(db, rig["rig"])
            await self.space.show(rig, now_ns)
            for alarm in rig["alarms"] if found.is_first else ():
                before = {"id": 0, "t_ns": now_ns, "by": alarm["acked_by"], "comment": None}
                await self.conditions.step(db, alarm, before)
        for step in found.steps:
            await self.conditions.step(db, step.document["alarm"], step.document)
