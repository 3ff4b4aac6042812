# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Looking for damage: the structure by SQLite's own checks, the rows by their checksums."""

import sqlite3
from collections.abc import Collection, Sequence
from itertools import repeat
from operator import is_
from typing import Any

import numpy as np

from agent.storage.database.checksum import row_crc
from agent.storage.database.columns import TABLES, columns_of, numbers_crc
from agent.storage.database.connect import damaged, is_damage
from agent.storage.database.schema import strange_schema
from agent.storage.tuning import NEWEST_ROWS, SMALL_PAGES
from agent.types import BoolArray, FloatArray

Row = tuple[Any, ...]
_NUMERIC = {"hops": 4, "estimates": 4, "spreads": 4}
"""Tables of numbers only, checked whole columns at a time -> how many of their columns are integers."""
_ORPHANS = """SELECT count(*) FROM estimates e WHERE NOT EXISTS
 (SELECT 1 FROM hops h WHERE h.seq = e.seq >> 10)
 OR NOT EXISTS (SELECT 1 FROM series s WHERE s.seq = e.series_id)
 OR NOT EXISTS (SELECT 1 FROM fits f WHERE f.seq = e.fit_id)"""


def good_rows(table: str, rows: Sequence[Row]) -> BoolArray:
    """Tell of each row, as `columns_of(table)` names its cells, whether its checksum is right."""
    if not rows:
        return np.zeros(0, dtype=bool)
    if table not in _NUMERIC:
        return np.array([_right(row) for row in rows])
    return good_columns(table, list(zip(*rows, strict=True)))


def good_columns(table: str, columns: Sequence[Collection[Any]]) -> BoolArray:
    """Tell the same of the rows of a table of numbers, given as the columns that they make."""
    try:
        return _numbers_right(table, columns)
    except (TypeError, ValueError, OverflowError):  # a cell that is not a number any more
        rows = list(zip(*columns, strict=True))
        plausible = np.array([_plausible(row, _NUMERIC[table]) for row in rows])
        right = np.zeros(len(rows), dtype=bool)
        if plausible.any():
            sound = zip(*(row for row, fine in zip(rows, plausible, strict=True) if fine), strict=True)
            right[plausible] = _numbers_right(table, list(sound))
        return right


def _numbers_right(table: str, cells: Sequence[Collection[Any]]) -> BoolArray:
    """Check columns of integers, then reals or None, then the checksum; raises where they are not."""
    *columns, stored = cells
    integers = _NUMERIC[table]
    whole = [np.array(c, dtype=np.int64) for c in columns[:integers]]
    real = [_reals(c) for c in columns[integers:]]
    return np.asarray(numbers_crc(table, [*whole, *real]) == np.array(stored, dtype=np.int64))


def _reals(column: Collection[Any]) -> FloatArray:
    """Return a column of reals or None; the columns that most rows leave empty take no time."""
    empty = all(map(is_, column, repeat(None)))
    return np.full(len(column), np.nan) if empty else np.array(column, dtype=np.float64)


def _plausible(row: Row, integers: int) -> bool:
    whole = all(isinstance(c, int | np.integer) for c in (*row[:integers], row[-1]))
    return whole and all(c is None or isinstance(c, int | float) for c in row[integers:-1])


def _right(row: Row) -> bool:
    try:
        return bool(row_crc(row[:-1]) == row[-1])
    except (TypeError, ValueError):
        return False


def problems(connection: sqlite3.Connection) -> list[str]:
    """Return what is wrong with an open database, in words; empty where all is well. Reads the whole file."""
    found: list[str] = []
    for check in (strange_schema, _structure, _rows, _orphans):
        try:
            found += check(connection)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            if (
                isinstance(error, sqlite3.OperationalError)
                and not is_damage(error)
                and "no such" not in str(error)
            ):
                raise
            found.append(str(error))
    return found


def problems_at_start(connection: sqlite3.Connection) -> list[str]:
    """Return what is wrong, as far as a start has time: small files whole, of large ones the newest rows.

    The rest of a large file is read bit by bit while the store is used (see `Scrubber`).
    """
    if connection.execute("PRAGMA page_count").fetchone()[0] <= SMALL_PAGES:
        return problems(connection)
    found = strange_schema(connection)
    for table in TABLES:
        newest = connection.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0
        rows = NEWEST_ROWS << 10 if table in {"estimates", "spreads"} else NEWEST_ROWS
        bad = bad_rows(connection, table, newest - rows, newest)
        if bad:
            found.append(f"{bad} rows of {table} have a wrong checksum")
    return found


class Scrubber:
    """Reads a large file bit by bit, round and round, so damage is found while rows can still be saved."""

    def __init__(self) -> None:
        self._table = 0
        self._after = -(2**62)

    def step(self, connection: sqlite3.Connection, rows: int = 500) -> None:
        """Check the next rows; raises sqlite3.DatabaseError (corrupt) when they are damaged."""
        table = list(TABLES)[self._table]
        query = f"SELECT {', '.join(columns_of(table))} FROM {table} WHERE seq > ? ORDER BY seq LIMIT ?"
        found = connection.execute(query, (self._after, rows)).fetchall()
        if not good_rows(table, found).all():
            raise damaged(f"rows of {table} have a wrong checksum")
        self._after = found[-1][0] if found else -(2**62)
        if len(found) < rows:
            self._table, self._after = (self._table + 1) % len(TABLES), -(2**62)


def _structure(connection: sqlite3.Connection) -> list[str]:
    return [text for (text,) in connection.execute("PRAGMA integrity_check(5)") if text != "ok"]


def _rows(connection: sqlite3.Connection) -> list[str]:
    found = []
    for table in TABLES:
        bad = bad_rows(connection, table, -(2**63), 2**63 - 1)
        if bad:
            found.append(f"{bad} rows of {table} have a wrong checksum")
    return found


def bad_rows(connection: sqlite3.Connection, table: str, first: int, last: int) -> int:
    """Return how many rows with first <= seq <= last have a wrong checksum."""
    query = f"SELECT {', '.join(columns_of(table))} FROM {table} WHERE seq BETWEEN ? AND ? ORDER BY seq"
    cursor = connection.execute(query, (first, last))
    bad = 0
    while rows := cursor.fetchmany(20_000):
        bad += int((~good_rows(table, rows)).sum())
    return bad


def _orphans(connection: sqlite3.Connection) -> list[str]:
    count = connection.execute(_ORPHANS).fetchone()[0]
    return [f"{count} estimates belong to nothing"] if count else []
