"""The schema of the store, and how a file of an earlier version becomes one of this version.

Tables are the product's own and may change; the views (agent.storage.database.views) are what outsiders
query. A row of an estimate is spread over three tables so that a year fits a small flash: `hops` says which
run and when, `estimates` holds one row a parameter (its seq is the hop's seq times 1024 plus its column), and
what seldom changes (series, fits, verdicts) is named by number.
"""

import sqlite3
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from typing import TYPE_CHECKING

from agent import __version__
from agent.storage.database.checksum import with_crc
from agent.storage.database.columns import ADDED, TABLES, insert_sql
from agent.storage.database.views import VIEWS

if TYPE_CHECKING:
    from sqlite_utils.migrations import Migrations

APPLICATION_ID = 0x64744B31
"""Fixed by the file's format: bytes 68 to 71 of the file: "dtK1"."""
SCHEMA_VERSION = 9
"""Fixed by the file's format: counts up; a program refuses files of a version greater than its own."""
PAGE_SIZE = 1024
"""Fixed by the file's format: small pages: a second's commit dirties three of them, so a day of commits stays
under half a gigabyte."""
_CALLED = frozenset({"json_each"})  # table-valued functions in our views


@dataclass(frozen=True)
class _Step:
    """One migration, a version's: the tables, indexes and views that it makes, and what else it does.

    A view that there is already is made anew. Views stand with the version that changed them last: one that
    a later version makes anew is left to it.
    """

    tables: Sequence[str] = ()
    indexes: Sequence[str] = ()
    views: Sequence[str] = ()
    change: Callable[[sqlite3.Connection], None] = lambda _: None

    def take(self, connection: sqlite3.Connection, version: int) -> None:
        """Take the step in the transaction that is open, and mark the file as of its version."""
        for table in self.tables:
            columns = f"seq INTEGER PRIMARY KEY, {TABLES[table]}, crc INTEGER NOT NULL"
            connection.execute(f"CREATE TABLE {table} ({columns}) STRICT")
        self.change(connection)
        for index in self.indexes:
            connection.execute(f"CREATE INDEX {index}")
        for view in self.views:
            connection.execute(f"DROP VIEW IF EXISTS {view}")
            connection.execute(f"CREATE VIEW {view} AS {VIEWS[view]}")
        _mark(connection, version)


def _begin(connection: sqlite3.Connection) -> None:
    """Make what every version has: the cursors of consumers, and the rows that say whose file it is."""
    connection.execute(
        "CREATE TABLE consumers (seq INTEGER PRIMARY KEY, name TEXT NOT NULL, "
        "last_seq INTEGER NOT NULL DEFAULT 0, topic TEXT NOT NULL DEFAULT 'estimates', "
        "UNIQUE (name, topic)) STRICT"
    )
    rows = (("schema_version", "1"), ("created_by", f"deltak {__version__}"))
    for number, (key, value) in enumerate(rows, 1):
        connection.execute(insert_sql("meta"), with_crc((number, key, value)))


def _note_clocks(connection: sqlite3.Connection) -> None:
    """Note runs stamped by one setting of the wall clock: their stamps are true, so are ages of their rows.

    Earlier programs told of a step in an event; the stamps of a run without one are its own true times.
    """
    for seq, (run_id, first) in enumerate(connection.execute(_UNSTEPPED).fetchall(), 1):
        connection.execute(insert_sql("clocks"), with_crc((seq, run_id, run_id, None, first)))


_UNSTEPPED = """SELECT r.seq, (SELECT min(h.t_ns) FROM hops h WHERE h.run_id = r.seq
 AND h.span IN (0, 60, 3600)) AS a
 FROM runs r WHERE a IS NOT NULL AND NOT EXISTS (SELECT 1 FROM events e WHERE e.run_id = r.seq
 AND e.source = 'clock' AND e.cause = 'clock step') ORDER BY r.seq"""


def _add_columns(connection: sqlite3.Connection) -> None:
    """Add sd_repeat; what version 4 kept of a rig's disturbances is learnt anew, in another table."""
    for table, columns in ADDED.items():
        for column in columns:
            connection.execute(f"ALTER TABLE {table} ADD COLUMN {column} REAL")
    connection.execute("DROP TABLE IF EXISTS calibrations")


_STEPS = {
    "0001_tables_views_and_marks": _Step(
        ("meta", "rigs", "runs", "series", "fits", "verdicts", "hops", "estimates", "spreads", "overlaps",
         "alarms", "alarm_events", "health", "events", "counters", "sequences"),
        ("hops_by_time ON hops (run_id, span, t_ns)", "runs_by_rig ON runs (rig_id)",
         "series_by_run ON series (run_id)", "overlaps_by_run ON overlaps (run_id)",
         "alarms_by_run ON alarms (run_id)", "alarm_events_by_alarm ON alarm_events (alarm_id)",
         "health_by_run ON health (run_id, t_ns)"),
        ("v_alarm_events", "v_events", "v_meta"), _begin),
    # the samples kept around alarms
    "0002_event_records": _Step(
        ("event_records",), ("alarms_by_time ON alarms (run_id, raised_ns)",), ("v_event_records",)),
    # drift and skew of sources
    "0003_clocks": _Step(views=("v_health", "v_health_reasons")),
    "0004_calibrations": _Step(),
    "0005_steps": _Step(
        ("clocks",), ("clocks_by_run ON clocks (run_id)",), ("v_runs",), _note_clocks),
    # sd_repeat, beliefs on a rig's constants, and what was learnt of it whatever else changed
    "0006_repeat_and_verdicts": _Step(
        ("learnt", "hypotheses"), (),
        ("v_estimates", "v_estimates_windows", "v_latest", "v_tiers", "v_verdicts"), _add_columns),
    # one step, so that a file is never of a version whose tables it has in part
    "0007_forecasts_operations_baselines_notifications": _Step(
        ("forecasts", "shelves", "annotations", "sites", "graphs", "baselines", "notifications"),
        ("graphs_by_run ON graphs (run_id)", "annotations_by_alarm ON annotations (alarm_id)",
         "notifications_pending ON notifications (target) WHERE state = 'pending'"),
        ("v_forecast", "v_alarms", "v_baselines", "v_notifications")),
    # what healthy parameters may depend on; what the paper's conditions say of each window
    "0008_covariates_conditions": _Step(
        ("covariates", "conditions"), ("covariates_by_run ON covariates (run_id, span, t_ns)",),
        ("v_covariates", "v_conditions")),
    # how parameters moved, as the agent saw it
    "0009_trends": _Step(("trends",), (), ("v_trend",)),
}  # fmt: skip
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
    for version, (name, step) in enumerate(_STEPS.items(), 1):
        steps(name=name)(lambda db, step=step, version=version: step.take(db.conn, version))
    return steps


@cache
def own_schema() -> dict[tuple[str, str], tuple[str, str | None]]:
    """Return what a file of this version consists of: (type, name) -> table, text."""
    with closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        for version, step in enumerate(_STEPS.values(), 1):
            step.take(connection, version)
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
    for version, (name, step) in enumerate(_STEPS.items(), 1):
        step.take(connection, version)
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
