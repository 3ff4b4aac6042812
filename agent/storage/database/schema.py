"""The tables of the store and how a file of an earlier version becomes one of this version.

Tables are the product's own and may change; the views (agent.storage.database.views) are what outsiders
query. A row of an estimate is spread over three tables so that a year fits a small flash: `hops` says which
run and when, `estimates` holds one row a parameter (its seq is the hop's seq times 1024 plus its column), and
what seldom changes (series, fits, verdicts) is named by number.
"""

import sqlite3
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from datetime import UTC, datetime
from functools import cache
from itertools import chain
from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

from agent import __version__
from agent.storage.database.checksum import column_crc, row_crc
from agent.storage.database.views import CLOCKS, EVENT_RECORDS, VIEWS
from agent.storage.database.views_of_baselines import BASELINES
from agent.storage.database.views_of_conditions import CONDITIONS
from agent.storage.database.views_of_covariates import COVARIATES
from agent.storage.database.views_of_forecasts import FORECASTS
from agent.storage.database.views_of_notifications import NOTIFICATIONS
from agent.storage.database.views_of_operations import OPERATIONS
from agent.storage.database.views_of_parts import REPEAT_AND_VERDICTS, STEPS

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from sqlite_utils import Database
    from sqlite_utils.migrations import Migrations

APPLICATION_ID = 0x64744B31
"""Bytes 68 to 71 of the file: "dtK1"."""
SCHEMA_VERSION = 8
"""Counts up; a program refuses files of a version greater than its own."""
PAGE_SIZE = 1024
"""Small pages: a second's commit dirties three of them, so a day of commits stays under half a gigabyte."""
COLUMN_BITS = 10
"""estimates.seq = hops.seq << COLUMN_BITS | column."""
ROWS_AT_ONCE = 64
"""Of 20 columns at the most: a statement may have 32,766 values."""

TABLES: dict[str, str] = {
    "meta": "key TEXT NOT NULL UNIQUE, value TEXT NOT NULL",
    "rigs": "name TEXT NOT NULL UNIQUE",
    "runs": "rig_id INTEGER NOT NULL, kind TEXT NOT NULL, started_ns INTEGER NOT NULL, "
    "code_version TEXT NOT NULL, "
    "config_sha256 TEXT NOT NULL, baseline_id INTEGER, boot_id TEXT, full_from_ns INTEGER, "
    "minute_from_ns INTEGER",
    "series": "run_id INTEGER NOT NULL, parameter TEXT NOT NULL, unit TEXT NOT NULL, method TEXT NOT NULL, "
    "reference REAL, baseline_id INTEGER",
    "fits": "window_s REAL, n_used INTEGER NOT NULL, n_missing INTEGER NOT NULL, dof REAL, t95 REAL, "
    "chosen INTEGER NOT NULL",
    "verdicts": "status TEXT NOT NULL, reason TEXT",
    "hops": "run_id INTEGER NOT NULL, span INTEGER NOT NULL, t_ns INTEGER NOT NULL",
    "estimates": "series_id INTEGER NOT NULL, fit_id INTEGER NOT NULL, verdict_id INTEGER NOT NULL, "
    "value REAL, "
    "sd REAL, lower REAL, upper REAL, held REAL, held_age_s REAL",
    "spreads": "n INTEGER NOT NULL, n_valid INTEGER NOT NULL, worst_id INTEGER NOT NULL, low REAL, high REAL",
    "overlaps": "run_id INTEGER NOT NULL, by_run INTEGER NOT NULL, from_ns INTEGER NOT NULL, "
    "to_ns INTEGER NOT NULL",
    "alarms": "run_id INTEGER NOT NULL, kind TEXT NOT NULL, parameter TEXT NOT NULL, priority TEXT NOT NULL, "
    "state TEXT NOT NULL, raised_ns INTEGER NOT NULL, cleared_ns INTEGER, acked_ns INTEGER, acked_by TEXT, "
    "shelved_until_ns INTEGER, delta REAL, sd REAL, limit_value REAL, probability REAL, "
    "message TEXT NOT NULL",
    "alarm_events": "alarm_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, from_state TEXT NOT NULL, "
    "to_state TEXT NOT NULL, cause TEXT NOT NULL, by_whom TEXT, comment TEXT",
    "health": "run_id INTEGER NOT NULL, source TEXT NOT NULL, t_ns INTEGER NOT NULL, "
    "received INTEGER NOT NULL, "
    "used INTEGER NOT NULL, rejected INTEGER NOT NULL, dropped INTEGER NOT NULL, gaps INTEGER NOT NULL, "
    "lag_s REAL, reasons TEXT",
    "events": "run_id INTEGER NOT NULL, source TEXT NOT NULL, t_ns INTEGER NOT NULL, cause TEXT NOT NULL, "
    "message TEXT NOT NULL",
    "counters": "name TEXT NOT NULL UNIQUE, count INTEGER NOT NULL",
    "sequences": "name TEXT NOT NULL UNIQUE, high INTEGER NOT NULL",
    "event_records": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, kind TEXT NOT NULL, "
    "parameter TEXT NOT NULL, "
    "alarms INTEGER NOT NULL, file TEXT NOT NULL, state TEXT NOT NULL, from_ns INTEGER NOT NULL, "
    "to_ns INTEGER NOT NULL, samples INTEGER NOT NULL, bytes INTEGER NOT NULL, baseline_id INTEGER, "
    "message TEXT NOT NULL",
    "learnt": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, key TEXT NOT NULL, content TEXT NOT NULL",
    "hypotheses": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, hypothesis TEXT NOT NULL, "
    "size REAL, sd REAL, "
    "unit TEXT NOT NULL, probability REAL",
    "clocks": "run_id INTEGER NOT NULL, part_of INTEGER NOT NULL, offset_ns INTEGER, "
    "from_ns INTEGER NOT NULL",
    "shelves": "alarm_id INTEGER NOT NULL, run_id INTEGER NOT NULL, boot_id TEXT, "
    "monotonic_ns INTEGER NOT NULL, "
    "t_ns INTEGER NOT NULL, length_ns INTEGER NOT NULL",
    "annotations": "alarm_id INTEGER NOT NULL, advice TEXT, percent REAL",
    "sites": "run_id INTEGER NOT NULL, site TEXT, labels TEXT",
    "graphs": "run_id INTEGER NOT NULL, graph TEXT NOT NULL",
    "baselines": "rig_id INTEGER NOT NULL, parameter TEXT NOT NULL, unit TEXT NOT NULL, graph TEXT NOT NULL, "
    "reference REAL, sd REAL, spread_sd REAL, within_sd REAL, days_sd REAL, correlation_s REAL, "
    "n_effective REAL, "
    "covariates TEXT NOT NULL, from_ns INTEGER NOT NULL, until_ns INTEGER NOT NULL, n INTEGER NOT NULL",
    "forecasts": "run_id INTEGER NOT NULL, parameter TEXT NOT NULL, made_ns INTEGER NOT NULL, level REAL, "
    "limit_value REAL, status TEXT NOT NULL, p10_ns INTEGER, p50_ns INTEGER, p90_ns INTEGER, chance REAL, "
    "horizon_s REAL, family TEXT NOT NULL, draws TEXT NOT NULL, cause TEXT NOT NULL, scored_ns INTEGER, "
    "crossed_ns INTEGER, crps REAL, held INTEGER",
    "notifications": "alarm_event_id INTEGER NOT NULL, target TEXT NOT NULL, state TEXT NOT NULL, "
    "attempts INTEGER NOT NULL, last_error TEXT, done_ns INTEGER",
    "covariates": "run_id INTEGER NOT NULL, span INTEGER NOT NULL, t_ns INTEGER NOT NULL, "
    "name TEXT NOT NULL, "
    "unit TEXT NOT NULL, value REAL NOT NULL, n INTEGER NOT NULL",
    "conditions": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, window_s REAL NOT NULL, defect REAL, "
    "defect_outputs REAL, rank INTEGER NOT NULL, rank_joined INTEGER NOT NULL, defect_special REAL, "
    "z_zero INTEGER NOT NULL, iterations INTEGER NOT NULL, converged INTEGER NOT NULL, cost REAL, step REAL, "
    "passes INTEGER NOT NULL, ratio REAL, trail TEXT NOT NULL",
}
"""Columns of each table between `seq INTEGER PRIMARY KEY` and `crc INTEGER NOT NULL`, as it was made."""
ADDED = {"estimates": ("repeat",)}
"""Columns, all REAL, that a later version added: after `crc` in the file and before it everywhere else."""
_SINCE = {
    "event_records": 2, "clocks": 5, "learnt": 6, "hypotheses": 6, "forecasts": 7, "shelves": 7,
    "annotations": 7,
    "sites": 7, "graphs": 7, "baselines": 7, "notifications": 7, "covariates": 8, "conditions": 8,
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


def columns_of(table: str) -> list[str]:
    """Return the columns of a table in order, with seq and crc."""
    return [
        "seq",
        *(part.strip().split()[0] for part in TABLES[table].split(",")),
        *ADDED.get(table, ()),
        "crc",
    ]


def numbers_crc(
    table: str, columns: "Sequence[NDArray[np.int64] | NDArray[np.float64]]"
) -> "NDArray[np.int32]":
    """Return the checksums of rows of a table of numbers, given as the columns before crc."""
    return column_crc(*columns, later=len(ADDED.get(table, ())))


@cache
def insert_sql(table: str, verb: str = "INSERT", rows: int = 1) -> str:
    """Return the statement that inserts whole rows of a table; verb: "INSERT" or "INSERT OR REPLACE"."""
    names = columns_of(table)
    values = f"({', '.join('?' * len(names))})"
    return f"{verb} INTO {table} ({', '.join(names)}) VALUES {', '.join([values] * rows)}"


def insert_rows(connection: sqlite3.Connection, table: str, rows: Sequence[tuple[object, ...]]) -> None:
    """Put whole rows into a table, in the place of those of the same number.

    Many go with one statement: while SQLite runs one, other threads of Python compute.
    """
    whole = len(rows) - len(rows) % ROWS_AT_ONCE
    for first in range(0, whole, ROWS_AT_ONCE):
        cells = tuple(chain.from_iterable(rows[first : first + ROWS_AT_ONCE]))
        connection.execute(insert_sql(table, "INSERT OR REPLACE", ROWS_AT_ONCE), cells)
    connection.executemany(insert_sql(table, "INSERT OR REPLACE"), rows[whole:])


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
        db.conn.execute(insert_sql("meta"), (number, key, value, row_crc((number, key, value))))
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
        db.conn.execute(insert_sql("clocks"), (*cells, row_crc(cells)))
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


_STEPS: dict[str, Callable[["Database"], None]] = {
    "0001_tables_views_and_marks": _tables_views_and_marks,
    "0002_event_records": _event_records,
    "0003_clocks": _clocks,
    "0004_calibrations": _calibrations,
    "0005_steps": _steps,
    "0006_repeat_and_verdicts": _repeat_and_verdicts,
    "0007_forecasts_operations_baselines_notifications": _forecasts_operations_baselines_notifications,
    "0008_covariates_conditions": _covariates_conditions,
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
    connection.execute(insert_sql("meta", "INSERT OR REPLACE"), (*cells, row_crc(cells)))
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
    return {(kind, name): (table, text) for kind, name, table, text in rows}


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
