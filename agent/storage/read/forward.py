# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Rows stored after a cursor, by their growing numbers, for consumers beyond the gateway; read-only.

The columns are those of the views (CONTRACT section 7) with `seq` behind them, the number by which a consumer
knows a row again. Rows that a view does not show (covered by a newer run, aggregates, wrong checksums) move
the cursor all the same.
"""

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final, NamedTuple

from agent.errors import StoreError
from agent.storage.database.columns import COLUMN_BITS
from agent.storage.database.connect import Reader, connect_reader, unreadable
from agent.storage.read.proof import row_of
from agent.storage.read.queries import view_rows
from agent.storage.tuning import BATCHES_A_CONNECTION

Row = dict[str, Any]
_LAST_COLUMN: Final = (1 << COLUMN_BITS) - 1  # fixed by the file's format
_TABLES: Final = {"alarms": "alarm_events", "estimates": "hops", "events": "events", "health": "health"}
_STEP: Final = ("kind", "parameter", "priority", "message", "delta", "sd", "limit_value", "probability")
"""What a step of an alarm says of the alarm itself."""


class Chunk(NamedTuple):
    """Rows in the order of their numbers, the cursor of whoever has them, and whether there may be more."""

    rows: list[Row]
    reached: int
    more: bool


class Feed:
    """Reads one database for one consumer; a file that was replaced meanwhile is opened anew.

    Args:
        path: of the database.
        parameters: those whose estimates and alarms are read; None for all.
    """

    def __init__(self, path: Path, parameters: Sequence[str] | None = None) -> None:
        self._path, self._parameters = path, parameters
        self._reader: Reader | None = None
        self._file: tuple[int, int] | None = None
        self._batches = 0

    def reached(self, topics: Sequence[str]) -> dict[str, int]:
        """Return the cursors, by topic, of whoever has all that there is. Raises StoreError."""
        found: dict[str, int] = self._asked(lambda reader: {topic: _head(reader, topic) for topic in topics})
        return found

    def head(self, topic: str) -> int:
        """Return the same of one topic."""
        return self.reached((topic,))[topic]

    def after(self, topic: str, cursor: int, until: int | None, most: int) -> Chunk:
        """Return what was stored of a topic after a cursor: instants of estimates, or rows, `most` at once.

        until: the cursor after which nothing is wanted; None for all that there is. Raises StoreError.
        """
        last = 2**62 if until is None else until
        chunk: Chunk = self._asked(lambda reader: _READERS[topic](reader, cursor, last, most))
        if self._parameters is None or topic not in {"estimates", "alarms"}:
            return chunk
        return chunk._replace(rows=[row for row in chunk.rows if row["parameter"] in self._parameters])

    def newest(self) -> list[Row]:
        """Return v_latest of all rigs. Raises StoreError."""
        rows: list[Row] = self._asked(lambda reader: view_rows(reader, "v_latest", "1 = 1", (), "e"))
        return [row for row in rows if self._parameters is None or row["parameter"] in self._parameters]

    def close(self) -> None:
        """Close the file; it is opened again when something is asked."""
        if self._reader is not None:
            self._reader.close()
        self._reader = None

    def _asked(self, question: Any) -> Any:
        """Return the answer to a question, in one state of the file."""
        try:
            reader = self._opened()
            reader.execute("BEGIN")
            try:
                return question(reader)
            finally:
                reader.execute("ROLLBACK")
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self.close()
            raise unreadable(self._path, error) from error
        except StoreError:
            self.close()
            raise

    def _opened(self) -> Reader:
        try:
            found = self._path.stat()
            file: tuple[int, int] | None = (found.st_dev, found.st_ino)
        except FileNotFoundError:
            file = None
        if file != self._file or self._batches >= BATCHES_A_CONNECTION:
            self.close()
        if self._reader is None:
            self._reader = connect_reader(self._path)
            self._batches = 0
        self._file = file
        self._batches += 1
        return self._reader


def all_reached(path: Path) -> dict[str, int]:
    """Return the cursor by topic of whoever has all of a database; from any thread. Raises StoreError."""
    with closing(Feed(path)) as feed:
        return feed.reached(tuple(_TABLES))


def lag(topic: str, numbers: int) -> int:
    """Return how many rows so many numbers of a topic are; of estimates, instants."""
    return numbers >> COLUMN_BITS if topic == "estimates" else numbers


def _head(reader: Reader, topic: str) -> int:
    table = _TABLES[topic]
    newest = int(reader.execute(f"SELECT coalesce(max(seq), 0) FROM {table}").fetchone()[0])
    return newest << COLUMN_BITS | _LAST_COLUMN if topic == "estimates" else newest


def _estimates(reader: Reader, cursor: int, until: int, most: int) -> Chunk:
    """Return rows of so many instants; the parts of a run are asked one by one, each by its time index."""
    bounds = (cursor >> COLUMN_BITS, until >> COLUMN_BITS, most)
    query = "SELECT seq, run_id, span, t_ns FROM hops WHERE seq > ? AND seq <= ? ORDER BY seq LIMIT ?"
    hops = reader.execute(query, bounds).fetchall()
    if not hops:
        return Chunk([], cursor, more=False)
    stamps: dict[int, list[int]] = {}
    for _, run, span, t_ns in hops:
        if span == 0:
            stamps.setdefault(run, []).append(t_ns)
    first, last = hops[0][0], hops[-1][0]
    condition = f"{row_of('r')} = ? AND span_s = 0 AND t_ns BETWEEN ? AND ? AND {row_of('h')} BETWEEN ? AND ?"
    found = [
        row
        for run, times in stamps.items()
        for row in view_rows(
            reader, "v_estimates", condition, (run, min(times), max(times), first, last), "e", first
        )
    ]
    return Chunk(sorted(found, key=_seq), last << COLUMN_BITS | _LAST_COLUMN, len(hops) == most)


def _numbered(reader: Reader, topic: str, cursor: int, until: int, most: int) -> tuple[int, bool]:
    """Return the number of the last of the rows that come next, and whether there may be more."""
    query = f"SELECT seq FROM {_TABLES[topic]} WHERE seq > ? AND seq <= ? ORDER BY seq LIMIT ?"
    found = reader.execute(query, (cursor, until, most)).fetchall()
    return (found[-1][0] if found else cursor), len(found) == most


def _alarms(reader: Reader, cursor: int, until: int, most: int) -> Chunk:
    last, more = _numbered(reader, "alarms", cursor, until, most)
    steps = view_rows(reader, "v_alarm_events", "id > ? AND id <= ? ORDER BY id", (cursor, last), "n")
    numbers = ",".join(str(row["alarm_id"]) for row in steps)
    known = (
        {row["id"]: row for row in view_rows(reader, "v_alarms", f"id IN ({numbers})", (), "a")}
        if steps
        else {}
    )
    rows = [_step(row, known[row["alarm_id"]]) for row in steps if row["alarm_id"] in known]
    return Chunk(rows, last, more)


def _step(row: Row, alarm: Mapping[str, Any]) -> Row:
    return {"rig": alarm["rig"], **row, **{name: alarm[name] for name in _STEP}}


def _events(reader: Reader, cursor: int, until: int, most: int) -> Chunk:
    last, more = _numbered(reader, "events", cursor, until, most)
    found = view_rows(reader, "v_events", "id > ? AND id <= ? ORDER BY id", (cursor, last), "n")
    return Chunk(found, last, more)


def _health(reader: Reader, cursor: int, until: int, most: int) -> Chunk:
    last, more = _numbered(reader, "health", cursor, until, most)
    number = row_of("x")
    condition = f"{number} > ? AND {number} <= ? ORDER BY {number}"
    return Chunk(view_rows(reader, "v_health", condition, (cursor, last), "x"), last, more)


def _seq(row: Row) -> int:
    return int(row["seq"])


_READERS: Final = {"alarms": _alarms, "estimates": _estimates, "events": _events, "health": _health}
