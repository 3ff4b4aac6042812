# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Rows proved before they are shown: a view's row counts if every table row that it is made of has its checksum.

A view is asked with the numbers of those rows beside its own columns, and with what it read of them from an index,
which has no checksum: the rows are then read once more by their numbers, and must say the same.
"""

import json
import re
import sqlite3
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import repeat
from typing import Any

from agent.storage.connect import Reader
from agent.storage.schema import TABLES, columns_of, own_schema
from agent.storage.verify import bad_rows, good_columns, good_rows

Cells = tuple[Any, ...]
_INDEXED = {
    "hops": ("run_id", "span", "t_ns"), "runs": ("rig_id",), "series": ("run_id",), "rigs": ("name",),
    "alarms": ("run_id", "raised_ns"), "alarm_events": ("alarm_id",), "health": ("run_id", "t_ns"),
}  # fmt: skip
"""Columns that an index holds as well, by table."""
_WHOLE = ("overlaps", "alarms")  # short tables that subqueries of views look into
_AT_ONCE = 20_000


def proven(reader: Reader, view: str, condition: str, values: Sequence[object]) -> tuple[list[str], Iterator[Cells]]:
    """Return the columns of a view and those of its rows under a condition that prove themselves."""
    query, parts = _traced(view)
    width = sum(1 + len(_INDEXED.get(table, ())) for table in parts)
    for table in _WHOLE:
        if re.search(rf"\b{table}\b", query):
            prove_whole(reader, table)
    cursor = reader.execute(f"SELECT * FROM ({query}) WHERE {condition}", tuple(values))
    return [column[0] for column in cursor.description][width:], _sound(reader, cursor, parts, width)


def prove_whole(reader: Reader, table: str) -> None:
    """Count the wrong rows of a short table, once."""
    if table not in reader.whole:
        reader.whole.add(table)
        reader.refuse(bad_rows(reader, table, -(2**63), 2**63 - 1))


def _sound(reader: Reader, cursor: sqlite3.Cursor, parts: Sequence[str], width: int) -> Iterator[Cells]:
    while rows := cursor.fetchmany(_AT_ONCE):
        said = list(zip(*(row[:width] for row in rows), strict=True))
        wrong, place = set[int](), 0
        for table in parts:
            columns = _INDEXED.get(table, ())
            seen = list(zip(*said[place : place + 1 + len(columns)], strict=True))
            bad = differing(reader, table, columns, set(seen))
            if bad:
                wrong.update(i for i, cells in enumerate(seen) if cells in bad)
            place += 1 + len(columns)
        reader.refuse(len(wrong))
        yield from (row[width:] for i, row in enumerate(rows) if i not in wrong)


def differing(reader: sqlite3.Connection, table: str, columns: Sequence[str], seen: set[Cells]) -> set[Cells]:
    """Return those of (seq, what columns said ...) that no row of a table with a right checksum says."""
    names = columns_of(table)
    places = [0, *(names.index(column) for column in columns)]
    query = f"SELECT {', '.join(names)} FROM {table} WHERE seq IN (SELECT value FROM json_each(?))"
    rows = reader.execute(query, (json.dumps([cells[0] for cells in seen]),)).fetchall()
    right = good_rows(table, rows)
    sound = rows if right.all() else [row for row, fine in zip(rows, right, strict=True) if fine]
    cells = list(zip(*sound, strict=True))
    return seen.difference(zip(*(cells[p] for p in places), strict=True)) if sound else seen


def sound_points(reader: Reader, rig: str, rows: list[Cells]) -> list[Cells]:
    """Return the rows of `point_columns` that prove themselves, and the rows of other tables that they name."""
    if not rows:
        return rows
    columns = list(zip(*rows, strict=True))
    hops, end = len(columns_of("hops")), len(columns) - 1
    right = good_columns("hops", columns[:hops]) & good_columns("estimates", columns[hops:end])
    for table, names, said in (
        ("rigs", ("name",), (columns[end], repeat(rig, len(rows)))),
        ("runs", ("rig_id",), (columns[1], columns[end])),
        ("series", (), (columns[hops + 1],)),
        ("fits", (), (columns[hops + 2],)),
    ):
        seen = list(zip(*said, strict=True))
        bad = differing(reader, table, names, set(seen))
        if bad:
            right &= [cells not in bad for cells in seen]
    if right.all():
        return rows
    reader.refuse(int((~right).sum()))
    return [row for row, fine in zip(rows, right, strict=True) if fine]


def points_of(rows: list[Cells]) -> list[Cells]:
    """Return (t_ns in the middle of what it covers, value, sd, span_s) of rows of `point_columns`."""
    first = len(columns_of("hops"))
    value, sd = (first + columns_of("estimates").index(name) for name in ("value", "sd"))
    return [(row[3] + row[2] * 500_000_000, row[value], row[sd], row[2]) for row in rows]


def point_columns() -> str:
    """Return the columns of an instant h, an estimate e and its rig g that `sound_points` looks at."""
    of = (("h", "hops"), ("e", "estimates"))
    return ", ".join([*(f"{alias}.{name}" for alias, table in of for name in columns_of(table)), "g.seq"])


@cache
def _traced(view: str) -> tuple[str, tuple[str, ...]]:
    """Return the text of a view with the numbers and indexed columns of its rows before its own; and their tables."""
    _, text = own_schema()["view", view]
    columns = re.split(r"\bSELECT\b", str(text), maxsplit=1)[1]
    rest = columns
    while "(" in rest:
        rest = re.sub(r"\([^()]*\)", "", rest)
    parts = [(t, alias) for t, alias in re.findall(r"\b(?:FROM|JOIN) (\w+) (\w)\b", rest) if t in TABLES]
    traced = (
        f'{alias}.{name} AS "proof {alias} {name}"'
        for table, alias in parts
        for name in ("seq", *_INDEXED.get(table, ()))
    )
    return f"SELECT {', '.join(traced)}, {columns}", tuple(table for table, _ in parts)
