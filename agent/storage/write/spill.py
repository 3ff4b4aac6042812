"""A side file for rows while a reader that never ends keeps the write-ahead log from being emptied.

SQLite cannot reuse the log past what its oldest reader still looks at, and no process can end another's
reading. So that neither the log grows without bound nor a row waits unacknowledged, rows then go to a second
database of the same tables, DB.spill, and into the first when the reader has gone, or at the next start.
Until then views do not show them.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

from agent.storage.database.columns import TABLES, columns_of, insert_sql
from agent.storage.database.connect import build, connect_writer, transaction
from agent.storage.database.files import beside, remove_database, sync_folder
from agent.storage.database.verify import good_rows
from agent.storage.tuning import ROWS_READ


def spill_path(path: Path) -> Path:
    """Return where the side file of a database lies."""
    return beside(path, ".spill")


def open_spill(path: Path) -> sqlite3.Connection:
    """Open or make the side file of the database at `path`."""
    side = spill_path(path)
    if not side.exists():
        fresh = beside(path, ".spilling")
        remove_database(fresh)
        build(fresh)
        fresh.rename(side)
    connection = connect_writer(side)
    try:
        connection.execute(
            "SELECT count(*) FROM meta"
        ).fetchone()  # makes its log, whose name must last as well
        sync_folder(path.parent)
    except BaseException:
        connection.close()
        raise
    return connection


def merge(path: Path, target: sqlite3.Connection) -> int:
    """Move the rows of the side file into the database and delete it; returns how many.

    Cut short, it is done again from the start.
    A row is inserted under its own number, so that moving it twice changes nothing.
    """
    side = spill_path(path)
    if not side.exists():
        return 0
    moved = 0
    with closing(connect_writer(side)) as source:
        for table in TABLES:
            moved += _move(source, target, table)
    remove_database(side)
    sync_folder(path.parent)
    return moved


def _move(source: sqlite3.Connection, target: sqlite3.Connection, table: str) -> int:
    if table == "meta":
        return 0
    query = f"SELECT {', '.join(columns_of(table))} FROM {table} ORDER BY seq"  # noqa: S608 - own names
    cursor = source.execute(query)
    moved = 0
    while rows := cursor.fetchmany(ROWS_READ):
        sound = [row for row, right in zip(rows, good_rows(table, rows), strict=True) if right]
        with transaction(target):
            target.executemany(insert_sql(table, "INSERT OR REPLACE"), sound)
        target.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        moved += len(sound)
    return moved
