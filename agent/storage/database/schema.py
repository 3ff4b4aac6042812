"""The schema of the store, and how a file of an earlier version becomes one of this version.

Tables are the product's own and may change; the views (agent.storage.database.views) are what outsiders
query. A row of an estimate is spread over three tables so that a year fits a small flash: `hops` says which
run and when, `estimates` holds one row a parameter (its seq is the hop's seq times 1024 plus its column), and
what seldom changes (series, fits, verdicts) is named by number.
"""

import sqlite3
import sys
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

from agent import __version__
from agent.storage.database.checksum import with_crc
from agent.storage.database.columns import ADDED, TABLES, insert_sql
from agent.storage.database.views import CLOCKS, EVENT_RECORDS, VIEWS
from agent.storage.database.views_of_parts import REPEAT_AND_VERDICTS, STEPS
from agent.storage.database.views_since_version_7 import (
    BASELINES,
    CONDITIONS,
    COVARIATES,
    FORECASTS,
    NOTIFICATIONS,
    OPERATIONS,
    TRENDS,
)

if TYPE_CHECKING:
    from sqlite_utils import Database
    from sqlite_utils.migrations import Migrations

APPLICATION_ID = 0x64744B31
"""Bytes 68 to 71 of the file: "dtK1"."""
SCHEMA_VERSION = 9
"""Counts up; a program refuses files of a version greater than its own."""
PAGE_SIZE = 1024
"""Small pages: a second's commit dirties three of them, so a day of commits stays under half a gigabyte."""
_SINCE = {
    "event_records": 2, "clocks": 5, "learnt": 6, "hypotheses": 6, "forecasts": 7, "shelves": 7,
    "annotations": 7,
    "sites": 7, "graphs": 7, "baselines": 7, "notifications": 7, "covariates": 8, "conditions": 8,
    "trends": 9,
}  # fmt: skip
"""The version that brought a table, of those that version 1 did not have."""

_CALLED = frozenset({"json_each"})  # table-valued functions in our views

_CONSUMERS = (
    "CREATE TABLE consumers (seq INTEGER PRIMARY KEY, name TEXT NOT NULL, "
    "last_seq INTEGER NOT NULL DEFAULT 0, "
    "topic TEXT NOT NULL DEFAULT 'estimates', UNIQUE (name, topic)) STRICT"
)

_INDEXES = (
    "CREATE INDEX hops_by_time ON hops (run_id, span, t_ns)",
    "CREATE INDEX runs_by_rig ON runs (rig_id)",
    "CREATE INDEX series_by_run ON series (run_id)",
    "CREATE INDEX overlaps_by_run ON overlaps (run_id)",
    "CREATE INDEX alarms_by_run ON alarms (run_id)",
    "CREATE INDEX alarm_events_by_alarm ON alarm_events (alarm_id)",
    "CREATE INDEX health_by_run ON health (run_id, t_ns)",
)


def _tables_views_and_marks(db: "Database") -> None:
    """Make everything of version 1 in the transaction that the migration runs in."""
    for table in TABLES:
        if table not in _SINCE:
            _create(db.conn, table)
    for statement in (_CONSUMERS, *_INDEXES, *VIEWS):
        db.conn.execute(statement)
    for number, (key, value) in enumerate(
        (("schema_version", "1"), ("created_by", f"deltak {__version__}")), 1
    ):
        db.conn.execute(insert_sql("meta"), with_crc((number, key, value)))
    _mark(db.conn, 1)


def _event_records(db: "Database") -> None:
    """Version 2: the index of the samples kept around alarms."""
    _create(db.conn, "event_records")
    db.conn.execute("CREATE INDEX alarms_by_time ON alarms (run_id, raised_ns)")
    db.conn.execute(EVENT_RECORDS)
    _mark(db.conn, 2)


def _clocks(db: "Database") -> None:
    """Version 3: drift and skew of sources in v_health."""
    for statement in CLOCKS:
        db.conn.execute(statement)
    _mark(db.conn, 3)


def _calibrations(db: "Database") -> None:
    """Version 4: what was learnt of a rig's disturbances, in a table that version 6 has no more."""
    _mark(db.conn, 4)


def _steps(db: "Database") -> None:
    """Version 5: which rows of a run were stamped by one setting of the wall clock, so that ages are true.

    Earlier programs told of a step in an event; the stamps of a run without one are its own true times.
    """
    _create(db.conn, "clocks")
    db.conn.execute("CREATE INDEX clocks_by_run ON clocks (run_id)")
    for seq, (run_id, first) in enumerate(db.conn.execute(_UNSTEPPED).fetchall(), 1):
        cells = (seq, run_id, run_id, None, first)
        db.conn.execute(insert_sql("clocks"), with_crc(cells))
    for statement in STEPS:
        db.conn.execute(statement)
    _mark(db.conn, 5)


_UNSTEPPED = """SELECT r.seq, (SELECT min(h.t_ns) FROM hops h WHERE h.run_id = r.seq
 AND h.span IN (0, 60, 3600)) AS a
 FROM runs r WHERE a IS NOT NULL AND NOT EXISTS (SELECT 1 FROM events e WHERE e.run_id = r.seq
 AND e.source = 'clock' AND e.cause = 'clock step') ORDER BY r.seq"""


def _repeat_and_verdicts(db: "Database") -> None:
    """Version 6: sd_repeat, beliefs on a rig's constants, and what was learnt of it whatever else changed."""
    for table, columns in ADDED.items():
        for column in columns:
            db.conn.execute(f"ALTER TABLE {table} ADD COLUMN {column} REAL")
    db.conn.execute("DROP TABLE IF EXISTS calibrations")
    _create(db.conn, "learnt")
    _create(db.conn, "hypotheses")
    for statement in REPEAT_AND_VERDICTS:
        db.conn.execute(statement)
    _mark(db.conn, 6)


def _forecasts_operations_baselines_notifications(db: "Database") -> None:
    """Version 7: forecasts; shelves, advice and site beside alarms; baselines; what targets are notified of.

    One step, so that a file is never of a version whose tables it has in part.
    """
    for table in ("forecasts", "shelves", "annotations", "sites", "graphs", "baselines", "notifications"):
        _create(db.conn, table)
    db.conn.execute("CREATE INDEX graphs_by_run ON graphs (run_id)")
    for statement in (FORECASTS, *OPERATIONS, *BASELINES, *NOTIFICATIONS):
        db.conn.execute(statement)
    _mark(db.conn, 7)


def _covariates_conditions(db: "Database") -> None:
    """Version 8: what healthy parameters may depend on; what the paper's conditions say of each window."""
    for table in ("covariates", "conditions"):
        _create(db.conn, table)
    for statement in (*COVARIATES, *CONDITIONS):
        db.conn.execute(statement)
    _mark(db.conn, 8)


def _trends(db: "Database") -> None:
    """Version 9: how parameters moved, as the agent saw it."""
    _create(db.conn, "trends")
    db.conn.execute(TRENDS)
    _mark(db.conn, 9)


_STEPS: dict[str, Callable[["Database"], None]] = {
    "0001_tables_views_and_marks": _tables_views_and_marks,
    "0002_event_records": _event_records,
    "0003_clocks": _clocks,
    "0004_calibrations": _calibrations,
    "0005_steps": _steps,
    "0006_repeat_and_verdicts": _repeat_and_verdicts,
    "0007_forecasts_operations_baselines_notifications": _forecasts_operations_baselines_notifications,
    "0008_covariates_conditions": _covariates_conditions,
    "0009_trends": _trends,
}
"""The migrations in order. A view's text is part of a version: a file where it differs counts as damaged."""


_RECORD_OF_MIGRATIONS = (
    """CREATE TABLE "_sqlite_migrations" (
   "id" INTEGER PRIMARY KEY,
   "migration_set" TEXT,
   "name" TEXT,
   "applied_at" TEXT
)""",
    """CREATE UNIQUE INDEX "idx__sqlite_migrations_migration_set_name"
    ON "_sqlite_migrations" ("migration_set", "name")""",
)
"""sqlite-utils' table of the migrations that were applied, in its own words."""


def _create(connection: sqlite3.Connection, table: str) -> None:
    columns = TABLES[table]
    connection.execute(
        f"CREATE TABLE {table} (seq INTEGER PRIMARY KEY, {columns}, crc INTEGER NOT NULL) STRICT"
    )


def _mark(connection: sqlite3.Connection, version: int) -> None:
    """Write the file's marks; they are part of the transaction like any row."""
    (seq,) = connection.execute("SELECT seq FROM meta WHERE key = 'schema_version'").fetchone()
    cells = (seq, "schema_version", str(version))
    connection.execute(insert_sql("meta", "INSERT OR REPLACE"), with_crc(cells))
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}")
    connection.execute(f"PRAGMA user_version = {version_mark(version)}")


def version_mark(version: int) -> int:
    """Return the user_version: the version, and its complement so that a flipped bit is no other version."""
    return (0x7FFF ^ version) << 16 | version


def version_of(connection: sqlite3.Connection) -> int:
    """Return the version of an open file; 0 when it has none."""
    return int(connection.execute("PRAGMA user_version").fetchone()[0]) & 0xFFFF


def steps_from(version: int) -> list[str]:
    """Return the names of the migrations that a file of a version has yet to go through."""
    return [name for name in _STEPS if int(name.partition("_")[0]) > version]


def migrations() -> "Migrations":
    """Return the ordered set; each step is one transaction together with the row that records it."""
    from sqlite_utils.migrations import Migrations

    steps = Migrations("deltak")
    for name, step in _STEPS.items():
        steps(name=name)(step)
    return steps


@cache
def own_schema() -> dict[tuple[str, str], tuple[str, str | None]]:
    """Return what a file of this version consists of: (type, name) -> table, text."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        for step in _STEPS.values():
            step(cast("Database", SimpleNamespace(conn=connection)))
        return _schema(connection)


def _schema(connection: sqlite3.Connection) -> dict[tuple[str, str], tuple[str, str | None]]:
    rows = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master")
    # a text that damage made a blob is none
    return {
        (kind, name): (table, text if isinstance(text, str) else None) for kind, name, table, text in rows
    }


def _bare(entry: tuple[str, str | None] | None) -> tuple[str, ...]:
    """Return an entry of a schema without spaces: earlier programs broke their lines elsewhere."""
    return () if entry is None else (entry[0], "".join((entry[1] or "").split()))


@cache
def _own() -> dict[tuple[str, str], tuple[tuple[str, str | None], tuple[str, ...]]]:
    """Return the own schema beside its entries without spaces: every connection is compared with it."""
    return {place: (entry, _bare(entry)) for place, entry in own_schema().items()}


def strange_schema(connection: sqlite3.Connection) -> list[str]:
    """Return in words what of a file's schema is not this program's own text; none of it is executed.

    Tables, indexes and views of others are left alone, but for those that stand in for what our views call.
    """
    found = _schema(connection)
    words = [f"the text of {kind} {name} is not its own" for (kind, name), (own, bare) in _own().items()
             if found.get((kind, name)) != own and _bare(found.get((kind, name))) != bare]  # fmt: skip
    others = (name for kind, name in found if kind == "trigger" or name.lower() in _CALLED)
    return words + [f"{name} does not belong there" for name in others]


def write_schema(connection: sqlite3.Connection) -> None:
    """Write the whole schema into a new file, with the record of migrations that upgrading it would leave.

    One transaction, and without sqlite-utils: its import is a good part of what a short replay takes to
    start.
    """
    connection.execute("BEGIN")
    for statement in _RECORD_OF_MIGRATIONS:
        connection.execute(statement)
    for name, step in _STEPS.items():
        step(cast("Database", SimpleNamespace(conn=connection)))
        row = ("deltak", name, str(datetime.now(UTC)))
        connection.execute(
            "INSERT INTO _sqlite_migrations (migration_set, name, applied_at) VALUES (?, ?, ?)", row
        )
    connection.execute("COMMIT")


def upgrade(connection: sqlite3.Connection) -> None:
    """Bring an open file to SCHEMA_VERSION; does nothing when it is there already.

    sqlite-utils takes half a second to import, so it is not touched on an ordinary start.
    """
    if version_of(connection) == SCHEMA_VERSION:
        return
    absent = sys.modules.setdefault("pandas", None)  # type: ignore[arg-type]  # sqlite-utils would load it: a second
    try:
        from sqlite_utils import Database
    finally:
        if absent is None:
            del sys.modules["pandas"]

    migrations().apply(Database(connection, execute_plugins=False))
