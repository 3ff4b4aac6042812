"""What is new in a file: sources with rates, alarm steps, and rows stored after a cursor; read-only."""
# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

from agent.storage.database.connect import Reader
from agent.storage.read.proof import FIRST, prove_listed, row_of
from agent.storage.read.queries import Rows, view_rows
from agent.storage.read.selection import reading
from agent.storage.tuning import HEALTH_ROWS

Row = dict[str, Any]


class Cursor(NamedTuple):
    """How far somebody has read: the number of the last step of an alarm, and of the last instant."""

    alarms: int = 0
    hops: int = 0

    def __str__(self) -> str:
        return f"{self.alarms}.{self.hops}"

    @classmethod
    def read(cls, text: str) -> Self | None:
        """Return the cursor that a text says; None where it says none."""
        match = re.fullmatch(r"([0-9]{1,18})\.([0-9]{1,18})", text)
        return cls(int(match[1]), int(match[2])) if match else None

    def reaches(self, other: Self) -> bool:
        """Tell whether all that the other has read is read here too."""
        return self.alarms >= other.alarms and self.hops >= other.hops


@dataclass(frozen=True, slots=True)
class Change:
    """Something that was committed: what kind, what it says, and the cursor of whoever has read it."""

    kind: str
    cursor: Cursor
    document: Mapping[str, Any]


def newest(db: Path | str) -> Cursor:
    """Return the cursor of whoever has read all that there is. Raises StoreError."""
    with reading(db) as reader:
        return Cursor(*(_highest(reader, table) for table in ("alarm_events", "hops")))


def changes(db: Path | str, after: Cursor, most: int = 200) -> tuple[list[Change], Cursor]:
    """Return what was committed after a cursor, oldest first of each kind, and the cursor after it.

    At most `most` steps of alarms and as many instants: the rest is asked for with the cursor that comes
    back. Rows that are not shown (covered by a newer run, thinned, of a wrong checksum) move the cursor all
    the same.

    Raises:
        StoreError: the file.
    """
    with reading(db) as reader:
        steps, last_step = _steps(reader, after, most)
        instants, last_hop = _instants(reader, after._replace(alarms=last_step), most)
    return [*steps, *instants], Cursor(last_step, last_hop)


def alarm_events(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_alarm_events with the rig of each, oldest first. Raises StoreError."""
    with reading(db) as reader:
        alarms = {row["id"]: row for row in view_rows(reader, "v_alarms", "1 = 1", ())}
        found = Rows(
            {"rig": alarms[row["alarm_id"]]["rig"], **row}
            for row in view_rows(reader, "v_alarm_events", "1 = 1 ORDER BY id", ())
            if row["alarm_id"] in alarms and rig in {None, alarms[row["alarm_id"]]["rig"]}
        )
        found.refused = reader.refused
    return found


def forecasts_mark(db: Path | str) -> tuple[int, int, int]:
    """Return numbers that change when v_forecast does: newest forecast, how many are scored, newest run.

    Raises StoreError.
    """
    query = (
        "SELECT coalesce(max(seq), 0), count(scored_ns), (SELECT coalesce(max(seq), 0) FROM runs) "
        "FROM forecasts"
    )
    with reading(db) as reader:
        newest_one, scored, run = reader.execute(query).fetchone()
    return int(newest_one), int(scored), int(run)


def sources(db: Path | str) -> Rows:
    """Return each source's newest v_health row if recent, with `rate_hz` since the row before.

    rate_hz is None for a source with one row. Raises StoreError.
    """
    with reading(db) as reader:
        tail = _highest(reader, "health") - HEALTH_ROWS
        prove_listed(reader, "health", tail)
        reader.listed["health"] = FIRST  # older rows are not asked for, so their index need not be compared
        condition = f"{row_of('x')} > ? ORDER BY {row_of('x')}"
        newest_rows: dict[tuple[str, str], Row] = {}
        for row in view_rows(reader, "v_health", condition, (tail,)):
            key = row["rig"], row["source"]
            newest_rows[key] = {**row, "rate_hz": _rate(newest_rows.get(key), row)}
        found = Rows(newest_rows.values())
        found.refused = reader.refused
    return found


def _rate(before: Row | None, row: Row) -> float | None:
    """Return samples a second between two rows of a source; a run that began anew counts from none."""
    if before is None or row["t_ns"] <= before["t_ns"]:
        return None
    more = row["received"] - before["received"]
    return None if more < 0 else more / ((row["t_ns"] - before["t_ns"]) / 1e9)


def _steps(reader: Reader, after: Cursor, most: int) -> tuple[list[Change], int]:
    last = _reached(reader, "alarm_events", after.alarms, most)
    rows = view_rows(reader, "v_alarm_events", "id > ? AND id <= ? ORDER BY id", (after.alarms, last))
    if not rows:
        return [], last
    numbers = ",".join(str(row["alarm_id"]) for row in rows)
    alarms = {row["id"]: row for row in view_rows(reader, "v_alarms", f"id IN ({numbers})", ())}
    found = [
        Change("alarm", after._replace(alarms=row["id"]), {**row, "alarm": alarms[row["alarm_id"]]})
        for row in rows
        if row["alarm_id"] in alarms
    ]
    return found, last


def _instants(reader: Reader, after: Cursor, most: int) -> tuple[list[Change], int]:
    """Return one change an instant, with the rows of all its parameters."""
    hops = reader.execute(
        "SELECT seq, run_id, span, t_ns FROM hops WHERE seq > ? ORDER BY seq LIMIT ?", (after.hops, most)
    ).fetchall()
    by_run: dict[int, dict[int, int]] = {}
    for seq, run, span, t_ns in hops:
        if span == 0:
            by_run.setdefault(run, {})[t_ns] = seq
    found = [
        Change(
            "estimates",
            after._replace(hops=seq),
            {"rig": rows[0]["rig"], "t_ns": rows[0]["t_ns"], "rows": rows},
        )
        for run, instants in by_run.items()
        for seq, rows in _rows_of_run(reader, run, instants, after.hops + 1)
    ]
    return sorted(found, key=lambda change: change.cursor.hops), hops[-1][0] if hops else after.hops


def _rows_of_run(
    reader: Reader, run: int, instants: Mapping[int, int], first: int
) -> list[tuple[int, list[Row]]]:
    """Return rows of v_estimates by the number of their instant; instants: those numbers by stamp."""
    condition = f"{row_of('r')} = ? AND span_s = 0 AND t_ns BETWEEN ? AND ?"
    bounds = (run, min(instants), max(instants))
    found: dict[int, list[Row]] = {}
    for row in view_rows(reader, "v_estimates", condition, bounds, first_hop=first):
        if row["t_ns"] in instants:
            found.setdefault(instants[row["t_ns"]], []).append(row)
    return list(found.items())


def _highest(reader: Reader, table: str) -> int:
    return int(reader.execute(f"SELECT coalesce(max(seq), 0) FROM {table}").fetchone()[0])


def _reached(reader: Reader, table: str, after: int, most: int) -> int:
    """Return the number of the row so many rows after another; of the last one where there are fewer."""
    query = (
        f"SELECT coalesce(max(seq), ?1) FROM (SELECT seq FROM {table} WHERE seq > ?1 ORDER BY seq LIMIT ?2)"
    )
    return int(reader.execute(query, (after, most)).fetchone()[0])
