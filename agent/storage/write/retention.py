# ruff: noqa: S608 - statements are put together from this module's own names; values are always bound
"""How long rows are kept: making minutes and hours, purging by age and by size.

A row's age is what `agent.storage.tables.ages` is sure of: where a wall clock is wrong rows stay longer,
never shorter.
"""

import sqlite3
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import ceil, isfinite
from typing import NamedTuple, Protocol

from agent.storage import tuning
from agent.storage.database.checksum import row_crc, with_crc
from agent.storage.database.columns import COLUMN_BITS, TABLES, columns_of
from agent.storage.database.schema import PAGE_SIZE
from agent.storage.tables.ages import Part, parts_of, shifts
from agent.storage.tables.covariates import thin
from agent.storage.tables.rows import Names, Numbers, Plan
from agent.storage.write.consumers.unsent import acknowledged, count_unsent
from agent.storage.write.rollups import Recent, add_groups, aggregate
from agent.units import HOUR_S, MINUTE_S, SECOND_NS

_OLD = "seq <= (SELECT seq FROM {table} ORDER BY seq DESC LIMIT 1 OFFSET ?)"
_OVER = {"events": "", "hypotheses": "", "forecasts": "", "trends": "", "conditions": "", "notifications": "",
         "alarms": " AND cleared_ns IS NOT NULL",
         "event_records": " AND state IN ('purged', 'failed')"}  # fmt: skip
"""What of a table may go: an alarm that stands and a record whose file is there stay, however old."""


def surplus(connection: sqlite3.Connection, kept: int = tuning.KEPT_RECORDS) -> dict[str, list[int]]:
    """Return the numbers of what `purge_logs` would delete, by the topic of consumers that it is of."""
    events, alarms = (_OLD.format(table=table) + _OVER[table] for table in ("events", "alarms"))
    queries = {
        "events": f"SELECT seq FROM events WHERE {events}",
        "alarms": f"SELECT seq FROM alarm_events WHERE alarm_id IN (SELECT seq FROM alarms WHERE {alarms})",
    }
    return {topic: [seq for (seq,) in connection.execute(query, (kept,))] for topic, query in queries.items()}


def purge_logs(connection: sqlite3.Connection, kept: int = tuning.KEPT_RECORDS) -> None:
    """Delete the oldest rows of what happened beyond a number; inside a transaction."""
    for table, over in _OVER.items():
        condition = _OLD.format(table=table) + over
        if table == "alarms":
            for part in ("alarm_events", "shelves", "annotations"):
                query = f"DELETE FROM {part} WHERE alarm_id IN (SELECT seq FROM alarms WHERE {condition})"
                connection.execute(query, (kept,))
        connection.execute(f"DELETE FROM {table} WHERE {condition}", (kept,))


@dataclass(frozen=True, slots=True)
class Retention:
    """How long each tier is kept, s (inf: for ever), and how large the file may grow, bytes."""

    full_s: float = 7 * 86400.0
    minute_s: float = 90 * 86400.0
    hour_s: float = float("inf")
    max_bytes: float = 1024e6


class Density(NamedTuple):
    """How densely a file holds rows: the periods of estimates (0: all) and commits, s, and for how long."""

    every_s: float
    keep: Retention
    commit_s: float


def bytes_per_rig_year(
    parameters: int, every_s: float, hop_s: float, keep: Retention, sources: int = 1, windows: int = 1,
    covariates: int = 0,
) -> int:  # fmt: skip
    """Return the size of the file after a year without alarms, as measured on files of this version.

    Rows go by the hour, and the newest hour of a rig stays whatever the bounds.

    Args:
        parameters: estimated parameters.
        every_s: the [store] key; 0 keeps every hop.
        hop_s: time between rows.
        keep: the [store] table's keep and max_mb.
        sources: a health row each every 10 s.
        windows: a row of each in the finest tier.
        covariates: a row each a minute, an hour of what is old.
    """
    period = max(every_s, hop_s)
    rows = [
        min(max(keep.full_s, HOUR_S), tuning.TIER_S) / period,
        min(keep.minute_s, tuning.TIER_S) / MINUTE_S,
        min(keep.hour_s, tuning.TIER_S) / HOUR_S,
    ]
    coarse = tuning.HOP_BYTES + parameters * (tuning.CELL_BYTES + tuning.SPREAD_BYTES)
    sizes = [tuning.HOP_BYTES + parameters * windows * tuning.CELL_BYTES, coarse, coarse]
    health = sources * (min(keep.full_s, tuning.TIER_S) / 10 + tuning.TIER_S / HOUR_S) * tuning.HEALTH_BYTES
    beside = covariates * (rows[1] + rows[2]) * tuning.COVARIATE_BYTES
    year = health + beside + sum(n * size for n, size in zip(rows, sizes, strict=True))
    return ceil(max(HOUR_S / period * sizes[0], min(keep.max_bytes, year)))


@dataclass(slots=True)
class _Progress:
    """How far a run's rows are aggregated (ns) and whether more can come."""

    minute_ns: int
    hour_ns: int
    growing: bool


class Database(Protocol):
    """What is asked of the store here: its connection, its numbers and names, and its transactions."""

    names: Names
    numbers: Numbers

    @property
    def connection(self) -> sqlite3.Connection: ...
    @property
    def hurried(self) -> bool: ...
    def transaction(self) -> AbstractContextManager[sqlite3.Connection]: ...
    def commit(self, plans: Sequence[Plan]) -> None: ...
    def count(self, name: str, more: int) -> None: ...


class TierKeeper:
    """Keeps the tiers of a store; called between commits, does a little each time.

    Purging never takes a row that a consumer (northbound) has not taken yet, but that the size of the file
    wins; such rows are counted in `counters` as "purged unsent", and for each consumer as "purged unsent:
    <its name>".
    """

    def __init__(self, store: Database, keep: Retention) -> None:
        self._store, self._keep = store, keep
        self._runs: dict[int, _Progress] = {}
        self._parts: dict[int, list[int]] = {}
        self._purged_at: dict[int, int] = {}
        self._recent = Recent()

    def retain(self, keep: Retention) -> None:
        """Keep rows for other times from now on."""
        self._keep = keep

    def load(self) -> None:
        """Find the runs whose rows are not all aggregated, whatever ended them."""
        for (run_id,) in self._store.connection.execute("SELECT seq FROM runs").fetchall():
            if run_id not in self._runs and self._newest(run_id, 0) is not None:
                progress = self._progress(run_id)
                newest = self._newest(run_id, 0) or 0
                if min(progress.minute_ns, progress.hour_ns) <= newest:
                    self._runs[run_id] = progress

    def watch(self, run_id: int, part: int) -> None:
        """Take up the part of a run that grows from now on; those that grew long before do not any more."""
        self._parts[run_id] = [*(p for p in self._parts.get(run_id, ()) if p != part), part]
        self._runs[part] = self._progress(part, growing=True)
        if self._oldest(part, 0) is None:
            self._recent.begin(part)
        for old in self._parts[run_id][: -tuning.OPEN_PARTS]:
            self._parts[run_id].remove(old)
            self._runs[old].growing = False

    def stored(self, plan: Plan) -> None:
        """Take note of what was committed."""
        self._recent.take(plan)

    def step(self, *, finish: bool = False) -> None:
        """Aggregate the periods that are over and purge what is too old or too much.

        finish: aggregate the unfinished periods as well; for the end of the runs.
        """
        for run_id, progress in list(self._runs.items()):
            self._aggregate(run_id, progress, finish or not progress.growing)
            if not progress.growing:
                del self._runs[run_id]
        self._purge_hourly()
        self._purge_size()

    # --- aggregating ----------------------------------------------------------------------------------------

    def _progress(self, run_id: int, *, growing: bool = False) -> _Progress:
        minute, hour = (self._newest(run_id, span) for span in (MINUTE_S, HOUR_S))
        oldest = self._oldest(run_id, 0)
        start = 0 if oldest is None else (oldest // tuning.PART_NS) * tuning.PART_NS
        minute_ns = start if minute is None else minute + MINUTE_S * SECOND_NS
        return _Progress(minute_ns, start if hour is None else hour + HOUR_S * SECOND_NS, growing)

    def _newest(self, run_id: int, span: int) -> int | None:
        return _edge(self._store.connection, run_id, span, "DESC")

    def _oldest(self, run_id: int, span: int) -> int | None:
        return _edge(self._store.connection, run_id, span, "ASC")

    def _aggregate(self, run_id: int, progress: _Progress, finish: bool) -> None:
        newest = self._newest(run_id, 0)
        if newest is None:
            return
        if progress.minute_ns == 0:  # the run's first rows came after it was taken up
            progress.minute_ns = progress.hour_ns = (
                (self._oldest(run_id, 0) or 0) // tuning.PART_NS
            ) * tuning.PART_NS
        over = newest + 1 + MINUTE_S * SECOND_NS if finish else newest - tuning.LATE_NS
        progress.minute_ns = self._fill(run_id, MINUTE_S, progress.minute_ns, over)
        over = progress.minute_ns + (HOUR_S * SECOND_NS if finish else 0)
        progress.hour_ns = self._fill(run_id, HOUR_S, progress.hour_ns, over)

    def _fill(self, run_id: int, span: int, first: int, over: int) -> int:
        """Aggregate whole periods from `first` on that end by `over`; return where the next starts."""
        length = span * SECOND_NS
        end = first + max(0, (over - first) // length) * length
        while first < end:
            stop = min(end, first + tuning.PART_NS)
            groups = aggregate(self._store.connection, self._recent, run_id, span, first, stop)
            if groups is not None:
                plan = Plan()
                add_groups(plan, groups, run_id, span, self._store.names, self._store.numbers)
                self._store.commit([plan])
                first = stop
            else:
                first = self._skip(run_id, span, stop, end)
            if self._store.hurried:  # the next start makes the others
                break
        return first

    def _skip(self, run_id: int, span: int, first: int, end: int) -> int:
        """Return the start of the next period that has rows, at most `end`; a run may pause for years."""
        source = 0 if span == MINUTE_S else MINUTE_S
        query = "SELECT t_ns FROM hops WHERE run_id = ? AND span = ? AND t_ns >= ? ORDER BY t_ns LIMIT 1"
        found = self._store.connection.execute(query, (run_id, source, first)).fetchone()
        return end if found is None else min(end, (found[0] // (span * SECOND_NS)) * span * SECOND_NS)

    # --- purging --------------------------------------------------------------------------------------------

    def _purge_hourly(self) -> None:
        """Purge by age once an hour of the rows' time; checking every run each second would cost too much."""
        hours = {run_id: (self._newest(run_id, 0) or 0) // tuning.PART_NS for run_id in self._runs}
        if hours != self._purged_at:
            self._purge_old()
            self._purge_logs()
            with self._store.transaction() as connection:
                thin(connection, self._store.numbers.take, self._keep.minute_s, self._keep.hour_s)
            self._purged_at = hours

    def _purge_logs(self) -> None:
        for topic, purged in surplus(self._store.connection).items():
            count_unsent(self._store.connection, topic, purged, self._store.count)
        with self._store.transaction() as connection:
            purge_logs(connection)

    def _purge_old(self) -> None:
        tiers = (0, self._keep.full_s), (MINUTE_S, self._keep.minute_s), (HOUR_S, self._keep.hour_s)
        bounded = [(span, keep_s) for span, keep_s in tiers if isfinite(keep_s)]
        for part, now_ns in _ages(self._store.connection):
            for span, keep_s in bounded:
                before = ((now_ns - round(keep_s * 1e9)) // tuning.PART_NS) * tuning.PART_NS
                self._purge_before(part.seq, span, min(before, self._aggregated(part.seq, span, before)))

    def _purge_before(self, run_id: int, span: int, before: int) -> None:
        """Purge rows of a tier older than `before`, unless there is no time for it now."""
        while not self._store.hurried and self._purge(run_id, span, before, self._sent()):
            pass

    def _aggregated(self, run_id: int, span: int, before: int) -> int:
        """Return up to where the next tier holds what this one would lose."""
        progress = self._runs.get(run_id)
        if progress is None or span == HOUR_S:
            return before
        return progress.hour_ns if span == MINUTE_S else progress.minute_ns // tuning.PART_NS * tuning.PART_NS

    def _sent(self) -> int:
        """Return the newest hop that every consumer has taken; a large number without consumers."""
        taken = acknowledged(self._store.connection, "estimates")
        return 2**62 if taken is None else taken >> COLUMN_BITS

    def _purge_size(self) -> None:
        """Drop the oldest rows, finest tier first, until the file is well within its bound."""
        if self.used_bytes() <= 0.95 * self._keep.max_bytes:
            return
        for _ in range(8):  # a step must not hold up the next commit
            victim = self._oldest_anywhere()
            if victim is None or self._store.hurried or self.used_bytes() <= 0.9 * self._keep.max_bytes:
                return
            run_id, span, oldest = victim
            self._purge(run_id, span, (oldest // tuning.PART_NS + 1) * tuning.PART_NS, 2**62)

    def make_room(self) -> None:
        """Drop the oldest hour of rows unless the file has free pages already; for a full disk."""
        if self._store.connection.execute("PRAGMA freelist_count").fetchone()[0] > tuning.FREE_PAGES:
            return
        victim = self._oldest_anywhere()
        if victim is not None:
            self._purge(victim[0], victim[1], (victim[2] // tuning.PART_NS + 1) * tuning.PART_NS, 2**62)

    def used_bytes(self) -> int:
        """Return what the rows take: the pages of the file that are not free."""
        pages, free = (
            self._store.connection.execute(f"PRAGMA {p}").fetchone()[0]
            for p in ("page_count", "freelist_count")
        )
        return int(pages - free) * PAGE_SIZE

    def _oldest_anywhere(self) -> tuple[int, int, int] | None:
        """Return (run, span, time) of the finest tier's oldest row; a rig's newest hour is never taken."""
        ages = _ages(self._store.connection)
        for span in (0, MINUTE_S, HOUR_S):
            found = [
                (oldest - now_ns, part.seq, oldest)
                for part, now_ns in ages
                if (oldest := self._oldest(part.seq, span)) is not None
                and oldest // tuning.PART_NS < now_ns // tuning.PART_NS
            ]
            if found:
                _, run_id, oldest = min(found)
                return run_id, span, oldest
        return None

    def _purge(self, run_id: int, span: int, before: int, sent: int) -> bool:
        """Delete rows of a run's tier older than `before`, but for hops after `sent`; True if more remain."""
        query = (
            "SELECT seq, t_ns FROM hops WHERE run_id = ? AND span = ? AND t_ns < ? AND seq <= ? "
            "ORDER BY t_ns LIMIT ?"
        )
        parts = (run_id, span, before, sent, tuning.HOPS_A_PURGE)
        found = self._store.connection.execute(query, parts).fetchall()
        if not found:
            return False
        hops = [seq for seq, _ in found]
        taken = self._sent()
        unsent = sum(seq > taken for seq in hops)
        with self._store.transaction() as connection:
            bounds = [(seq << COLUMN_BITS, (seq + 1 << COLUMN_BITS) - 1) for seq in hops]
            connection.executemany("DELETE FROM estimates WHERE seq BETWEEN ? AND ?", bounds)
            connection.executemany("DELETE FROM spreads WHERE seq BETWEEN ? AND ?", bounds)
            connection.executemany("DELETE FROM hops WHERE seq = ?", [(seq,) for seq in hops])
            self._note_purge(connection, run_id, span, found[-1][1] + 1)
            if span == 0:
                _thin_health(connection, run_id, found[-1][1] + 1)
        if unsent:
            self._store.count("purged unsent", unsent)
        if span == 0:
            count_unsent(self._store.connection, "estimates", hops, self._store.count, COLUMN_BITS)
        return len(found) == tuning.HOPS_A_PURGE

    def _note_purge(self, connection: sqlite3.Connection, run_id: int, span: int, reached: int) -> None:
        """Record from where a tier still stands, for the views, and how far numbers were given out."""
        if span != HOUR_S:
            left = _edge(connection, run_id, span, "ASC")
            reached = reached if left is None else min(reached, left)
            column = "full_from_ns" if span == 0 else "minute_from_ns"
            connection.execute(f"UPDATE runs SET {column} = ? WHERE seq = ?", (reached, run_id))
            names = columns_of("runs")[:-1]
            row_of_run = f"SELECT {', '.join(names)} FROM runs WHERE seq = ?"
            cells = connection.execute(row_of_run, (run_id,)).fetchone()
            connection.execute("UPDATE runs SET crc = ? WHERE seq = ?", (row_crc(cells), run_id))
        for table in ("hops", "health"):
            cells = (list(TABLES).index(table) + 1, table, self._store.numbers.high(table))
            connection.execute("INSERT OR REPLACE INTO sequences VALUES (?, ?, ?, ?)", with_crc(cells))


def _edge(connection: sqlite3.Connection, run_id: int, span: int, order: str) -> int | None:
    query = f"SELECT t_ns FROM hops WHERE run_id = ? AND span = ? ORDER BY t_ns {order} LIMIT 1"
    found = connection.execute(query, (run_id, span)).fetchone()
    return None if found is None else int(found[0])


def _ages(connection: sqlite3.Connection) -> list[tuple[Part, int]]:
    """Return all runs' parts with now in their stamps (ns): the rig's newest live row, or a replay's own."""
    found: list[tuple[Part, int]] = []
    for (rig,) in connection.execute("SELECT name FROM rigs ORDER BY seq").fetchall():
        parts = parts_of(connection, rig)
        shift = shifts(parts, confirmed=True)
        now: dict[int, int] = {}
        for part in parts:
            axis = 0 if part.live else part.run
            now[axis] = max(part.last_ns + shift[part.seq], now.get(axis, -(2**63)))
        found += [(part, now[0 if part.live else part.run] - shift[part.seq]) for part in parts]
    return found


def _thin_health(connection: sqlite3.Connection, run_id: int, before: int) -> None:
    """Keep of old health rows the last of each hour and source, and those a consumer does not have yet."""
    taken = acknowledged(connection, "health")
    kept = "SELECT max(seq) FROM health WHERE run_id = ?1 AND t_ns < ?2 GROUP BY source, t_ns / 3600000000000"
    query = f"DELETE FROM health WHERE run_id = ?1 AND t_ns < ?2 AND seq <= ?3 AND seq NOT IN ({kept})"
    connection.execute(query, (run_id, before, 2**62 if taken is None else taken))
