# ruff: noqa: S608 - statements are put together from numbers only
"""Rows of one parameter and baseline whose reference moved within a period, as rows of one series: its middle one."""

import sqlite3
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

Row = tuple[Any, ...]


def merged(connection: sqlite3.Connection, rows: Sequence[Row], length_ns: int) -> list[Row]:
    """Return rows (t_ns, series, ...) in order of series, then time, so that a period has one row a parameter."""
    groups = _groups(connection, {row[1] for row in rows})
    if not groups:
        return list(rows)
    within: dict[tuple[object, int], list[tuple[float, int]]] = defaultdict(list)
    for row in rows:
        if row[1] in groups:
            key, reference = groups[row[1]]
            within[key, row[0] // length_ns].append((reference, row[1]))
    middle = {place: sorted(members)[len(members) // 2][1] for place, members in within.items()}
    named = [
        (row[0], middle[groups[row[1]][0], row[0] // length_ns], *row[2:]) if row[1] in groups else row for row in rows
    ]
    return sorted(named, key=lambda row: (row[1], row[0]))


def _groups(connection: sqlite3.Connection, series: set[int]) -> dict[int, tuple[object, float]]:
    """Return parameter and baseline, and reference, of the series that share those with another one."""
    listed = ", ".join(map(str, sorted(series)))
    query = f"SELECT seq, run_id, parameter, baseline_id, reference FROM series WHERE seq IN ({listed})"
    found: dict[object, list[tuple[int, float]]] = defaultdict(list)
    for seq, run_id, parameter, baseline_id, reference in connection.execute(query):
        if baseline_id is not None and reference is not None:
            found[run_id, parameter, baseline_id].append((seq, reference))
    return {seq: (key, ref) for key, members in found.items() if len(members) > 1 for seq, ref in members}
