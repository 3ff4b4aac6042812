# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Rows proved before they are shown: a view's row counts if every table row it is made of has its checksum.

A view is asked with the numbers of those rows beside its own columns, and with what it read of them from an
index, which has no checksum: the rows are then read once more by their numbers, and must say the same.
"""

import json
import re
import sqlite3
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.storage.database.columns import TABLES, columns_of
from agent.storage.database.connect import Reader, damaged
from agent.storage.database.schema import own_schema
from agent.storage.database.verify import bad_rows, good_columns, good_rows
from agent.storage.tables.ages import Part
from agent.storage.tuning import POINTS_READ, ROWS_READ
from agent.types import BoolArray, FloatArray, IntArray, Status

Cells = tuple[Any, ...]
_INDEXED = {
    "hops": ("run_id", "span", "t_ns"), "runs": ("rig_id",), "series": ("run_id",), "rigs": ("name",),
    "alarms": ("run_id", "raised_ns"), "alarm_events": ("alarm_id",), "health": ("run_id", "t_ns"),
}  # fmt: skip
"""Columns that an index holds as well, by table."""
_WHOLE = ("overlaps", "alarms", "clocks", "annotations", "sites", "baselines")
"""Short tables that views look into for a row that may not be there."""
_SELDOM_GROW = ("rigs", "runs", "series")
FIRST, LAST = -(2**63), 2**63 - 1
"""Fixed by 64 bits: the ends of a stretch that is open: of stamps, ns, and of row numbers."""


def proven(
    reader: Reader,
    view: str,
    condition: str,
    values: Sequence[object],
    first_hop: int = FIRST,
    *,
    numbered: str = "",
) -> tuple[list[str], Iterator[Cells]]:
    """Return the columns of a view and those of its rows under a condition that prove themselves.

    first_hop: from which row of `hops` on their index is compared with them; older ones are not asked for.
    numbered: the alias of the table whose numbers follow the view's columns, as `seq`.
    """
    query, parts, looked_into = _traced(view)
    width = sum(1 + len(_INDEXED.get(table, ())) for table in parts)
    for table in looked_into:
        prove_whole(reader, table)
    for table in parts:
        prove_listed(reader, table, first_hop if table == "hops" else FIRST)
    more = f", {row_of(numbered)} AS seq" if numbered else ""
    cursor = reader.execute(f"SELECT *{more} FROM ({query}) WHERE {condition}", tuple(values))
    once = "json_each" not in query  # a row of a table may make several of those
    return [column[0] for column in cursor.description][width:], _sound(
        reader, cursor, parts, width, once=once
    )


def row_of(alias: str) -> str:
    """Return the column in which `proven` says the number of a table's row, for a condition."""
    return f'"proof {alias} seq"'


def prove_whole(reader: Reader, table: str) -> None:
    """Count the wrong rows of a short table, once; raises sqlite3.DatabaseError where its index omits one."""
    if table not in reader.whole:
        reader.whole.add(table)
        reader.refuse(bad_rows(reader, table, FIRST, LAST))
        prove_listed(reader, table)


def prove_listed(reader: Reader, table: str, first: int = FIRST) -> None:
    """See that the indexes of a table list its rows from a number on, once; raises sqlite3.DatabaseError.

    A row that none lists would not be shown, and an older one in its place. So would a row that an index
    lists and its page does not hold any more, which is looked for where all rows are asked for.
    """
    if first >= reader.listed.get(table, LAST):
        return
    reader.listed[table] = first
    names = columns_of(table)
    for index, columns in _indexes(table):
        if first == FIRST and reader.execute(_NOT_HELD.format(table, index)).fetchone() is not None:
            raise damaged("an index lists what its table does not hold")
        same = " AND ".join(f"i.{name} = t.{name}" for name in (*columns, "seq"))
        query = f"""SELECT {", ".join(names)} FROM {table} t NOT INDEXED WHERE t.seq >= ? AND NOT EXISTS (
 SELECT 1 FROM {table} i INDEXED BY {index} WHERE {same}) LIMIT {ROWS_READ}"""
        # one whose checksum is wrong is refused where the index says what it was
        if good_rows(table, reader.execute(query, (first,)).fetchall()).any():
            raise damaged("an index does not list what its table holds")


_NOT_HELD = """SELECT 1 FROM {0} i INDEXED BY {1} WHERE NOT EXISTS (
 SELECT 1 FROM {0} t NOT INDEXED WHERE t.seq = i.seq) LIMIT 1"""


def prove_names(reader: Reader) -> None:
    """See that every rig and run is there and as it was written, and every series there.

    A run that is gone, or not live any more, would leave the newest row of an older one to be shown as the
    newest. Counts the rows that are wrong; raises sqlite3.DatabaseError where one is gone.
    """
    for table in ("rigs", "runs"):
        prove_whole(reader, table)
    prove_listed(reader, "series")


@cache
def _indexes(table: str) -> list[tuple[str, list[str]]]:
    """Return the indexes of a table by name, each with its columns."""
    texts = [
        str(text) for (kind, _), (of, text) in own_schema().items() if (kind, of) == ("index", table) and text
    ]
    named = [re.fullmatch(rf"CREATE INDEX (\w+) ON {table} \((.*)\)", text) for text in texts]
    unique = re.match(r"(\w+) TEXT NOT NULL UNIQUE", TABLES[table])
    own = [(f"sqlite_autoindex_{table}_1", [unique[1]])] if unique else []
    return own + [(match[1], match[2].split(", ")) for match in named if match]


def prove_parts(reader: Reader, rig: str, parts: Sequence[Part]) -> None:
    """See that a rig's run parts are what they say, and the newest row the newest; or sqlite3.DatabaseError.

    A wrong one would move the rows of others in time.
    """
    if not parts:
        return
    refused = reader.refused
    prove_whole(reader, "clocks")
    named = reader.execute("SELECT seq FROM rigs NOT INDEXED WHERE name = ?", (rig,)).fetchall()
    edges = set[Cells]()
    for part in parts:
        for t_ns in (part.last_ns,) if part.known else (part.from_ns, part.last_ns):
            edges.update(reader.execute(_EDGE, (part.seq, t_ns)).fetchall())
    wrong = (
        differing(reader, "rigs", ("name",), {(seq, rig) for (seq,) in named}),
        differing(reader, "runs", ("rig_id",), {(part.seq, seq) for part in parts for (seq,) in named}),
        differing(reader, "hops", ("run_id", "span", "t_ns"), edges),
    )
    if any(wrong) or reader.refused > refused:
        raise damaged("a row that says when a run was has a wrong checksum")
    prove_listed(reader, "hops", max((cells[0] for cells in edges), default=FIRST))


_EDGE = (
    "SELECT seq, run_id, span, t_ns FROM hops WHERE run_id = ? AND span IN (0, 60, 3600) AND t_ns = ? LIMIT 1"
)


def _sound(
    reader: Reader, cursor: sqlite3.Cursor, parts: Sequence[str], width: int, *, once: bool
) -> Iterator[Cells]:
    before = set[Cells]()
    while rows := cursor.fetchmany(ROWS_READ):
        heads = [row[:width] for row in rows]
        said = list(zip(*heads, strict=True))
        wrong = _repeated(heads, before) if once else set[int]()
        place = 0
        before = set(heads)
        for table in parts:
            columns = _INDEXED.get(table, ())
            seen = list(zip(*said[place : place + 1 + len(columns)], strict=True))
            bad = _bad(reader, table, columns, set(seen))
            if bad:
                wrong.update(i for i, cells in enumerate(seen) if cells in bad)
            place += 1 + len(columns)
        reader.refuse(len(wrong))
        yield from (row[width:] for i, row in enumerate(rows) if i not in wrong)


def _bad(reader: Reader, table: str, columns: Sequence[str], seen: set[Cells]) -> set[Cells]:
    """Return what `differing` does; rows of tables that seldom grow are proved once a connection."""
    unknown = seen - reader.proved[table]
    bad = differing(reader, table, columns, unknown) if unknown else unknown
    if table in _SELDOM_GROW:
        reader.proved[table] |= unknown - bad
    return bad


def _repeated(heads: Sequence[Cells], before: set[Cells]) -> set[int]:
    """Return the places of rows that came already, here or just before: a damaged page may list one twice."""
    again = set[int]()
    shown = set[Cells]()
    for i, head in enumerate(heads):
        if head in shown or head in before:
            again.add(i)
        shown.add(head)
    return again


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


class Found(NamedTuple):
    """Valid estimates: (n,) stamp ns (of an aggregate, its middle), value, sd, sd_repeat, series."""

    t_ns: IntArray
    value: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    series: IntArray

    def at(self, rows: "BoolArray | NDArray[np.intp]") -> "Found":
        """Return the rows that a mask or an array of places names."""
        return Found(
            self.t_ns[rows], self.value[rows], self.sd[rows], self.sd_repeat[rows], self.series[rows]
        )


def joined(parts: Sequence[Found]) -> Found:
    """Return the rows of parts one after the other."""
    t_ns, series = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_ns", "series"))
    value, sd, repeat = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("value", "sd", "sd_repeat")
    )
    return Found(t_ns, value, sd, repeat, series)


NOTHING = Found(
    np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty(0), np.empty(0, dtype=np.int64)
)
_VALID = int(Status.VALID) << 8
_SAID = [name for name in columns_of("estimates") if name != "verdict_id"]
_POINTS = f"""SELECT h.seq, h.t_ns, h.crc, {", ".join(f"e.{name}" for name in _SAID)} FROM hops h
 CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN fits f ON f.seq = e.fit_id
 WHERE h.run_id = ? AND h.span = ? AND h.t_ns BETWEEN ? AND ? AND h.t_ns / ? % ? = 0 AND e.series_id IN ({{}})
 AND e.verdict_id = {_VALID} AND f.chosen = 1 AND e.value IS NOT NULL AND NOT EXISTS (SELECT 1 FROM overlaps o
 WHERE o.run_id = h.run_id AND h.t_ns BETWEEN o.from_ns AND o.to_ns) ORDER BY h.t_ns"""


def series_of(reader: Reader, parameter: str) -> dict[int, list[int]]:
    """Return the numbers of a parameter's series by run; no index is asked, which may leave one out."""
    found: dict[int, list[int]] = {}
    for seq, run in reader.execute(
        "SELECT seq, run_id FROM series NOT INDEXED WHERE parameter = ?", (parameter,)
    ):
        found.setdefault(run, []).append(seq)
    return found


def sound_points(
    reader: Reader, run: int, series: Sequence[int], span: int, first: int, last: int, each: int = 1
) -> Found:
    """Return the valid estimates of some series, of one tier, that prove themselves.

    Args:
        reader: of a file where `prove_parts` found nothing wrong with the run.
        run: number of a part of a run.
        series: their numbers.
        span: of the tier, s.
        first: the first stamp, ns.
        last: the last one, ns.
        each: of an aggregate, only periods whose number is a multiple of it.
    """
    prove_whole(reader, "overlaps")
    query = _POINTS.format(", ".join(map(str, series)))
    period_ns = max(span, 1) * 1_000_000_000
    cursor = reader.execute(query, (run, span, first, last, period_ns, each))
    pieces = []
    while rows := cursor.fetchmany(POINTS_READ):
        pieces.append(_sound_piece(reader, run, span, list(zip(*rows, strict=True))))
    if not pieces:
        return NOTHING
    numbers, right = (np.concatenate([piece[k] for piece in pieces]) for k in range(2))
    once = _first_ones(numbers)
    reader.refuse(int((~(right & once)).sum()))
    found = joined([piece[2] for piece in pieces])
    return found if once.all() else found.at(once[right])


def _sound_piece(
    reader: Reader, run: int, span: int, columns: Sequence[Cells]
) -> tuple[IntArray, BoolArray, Found]:
    """Return of rows of `_POINTS` their numbers, which of them prove themselves, and those."""
    right = _right(reader, run, span, columns)
    said = (1, *(3 + _SAID.index(name) for name in ("value", "sd", "repeat", "series_id")))
    kept = (columns[place] if right.all() else tuple(compress(columns[place], right)) for place in said)
    stamps, values, sds, repeats, series = kept
    middle = np.array(stamps, dtype=np.int64) + span * 500_000_000
    sd = np.array(sds, dtype=np.float64)
    share = 1e-4 * np.array(repeats, dtype=np.float64)
    sd_repeat = np.where(np.isnan(share), sd, sd * share)
    found = Found(middle, np.array(values, dtype=np.float64), sd, sd_repeat, np.array(series, dtype=np.int64))
    return np.array(columns[3], dtype=np.int64), right, found


def _right(reader: Reader, run: int, span: int, columns: Sequence[Cells]) -> BoolArray:
    """Tell of each row of `_POINTS` whether it proves itself, and what it names.

    What its condition fixes needs no reading: of a row that says otherwise the checksum is another.
    """
    seq, t_ns, hop_crc, own, series, fits, *cells = columns
    count = len(seq)
    right = good_columns("hops", (seq, np.full(count, run), np.full(count, span), t_ns, hop_crc))
    right &= good_columns("estimates", (own, series, fits, np.full(count, _VALID), *cells))
    for table, named in (("series", series), ("fits", fits)):
        bad = differing(reader, table, (), {(number,) for number in set(named)})
        if bad:
            right &= [(number,) not in bad for number in named]
    return right


def _first_ones(numbers: IntArray) -> BoolArray:
    """Tell of each row whether none before it has its number."""
    first = np.zeros(len(numbers), dtype=bool)
    first[np.unique(numbers, return_index=True)[1]] = True
    return first


@cache
def _traced(view: str) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Return a view's text with the numbers and indexed columns of its rows before its own; and their tables.

    Behind them those of `_WHOLE` that it looks into. What is joined by LEFT JOIN is one of these: there may
    be no row to be read once more.
    """
    _, text = own_schema()["view", view]
    columns = re.split(r"\bSELECT\b", str(text), maxsplit=1)[1]
    rest = columns
    while "(" in rest:
        rest = re.sub(r"\([^()]*\)", "", rest)
    parts = [
        (t, alias) for t, alias in re.findall(r"\b(?<!LEFT )(?:FROM|JOIN) (\w+) (\w)\b", rest) if t in TABLES
    ]
    traced = (
        f'{alias}.{name} AS "proof {alias} {name}"'
        for table, alias in parts
        for name in ("seq", *_INDEXED.get(table, ()))
    )
    query = f"SELECT {', '.join(traced)}, {columns}"
    looked_into = tuple(table for table in _WHOLE if re.search(rf"\b{table}\b", query))
    return query, tuple(table for table, _ in parts), looked_into
