# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Means of covariates, thinned to hours when they are old; series whose reference moves with them, merged."""

import sqlite3
from collections import defaultdict
from collections.abc import Callable, Iterable
from math import isfinite
from typing import Any

import numpy as np

from agent.records import CovariateMean
from agent.storage.database.checksum import checked, with_crc
from agent.storage.database.columns import columns_of, insert_sql
from agent.types import IntArray
from agent.units import HOUR_NS, HOUR_S, MINUTE_S


def merged(connection: sqlite3.Connection, t_ns: IntArray, series: IntArray, length_ns: int) -> IntArray:
    """Return the series (n,) of rows at t_ns (n,), named so that each such period has one a parameter."""
    groups = _groups(connection, set(np.unique(series).tolist()))
    within: dict[tuple[object, int], list[tuple[float, int, int]]] = defaultdict(list)
    for place in np.flatnonzero(np.isin(series, list(groups))).tolist():
        key, reference = groups[int(series[place])]
        within[key, int(t_ns[place]) // length_ns].append((reference, int(series[place]), place))
    named = series.copy()
    for members in within.values():
        _, middle, _ = sorted(members)[len(members) // 2]
        named[[place for _, _, place in members]] = middle
    return named


def _groups(connection: sqlite3.Connection, series: set[int]) -> dict[int, tuple[object, float]]:
    """Return parameter and baseline, and reference, of the series that share those with another one."""
    listed = ", ".join(map(str, sorted(series)))
    query = f"SELECT seq, run_id, parameter, baseline_id, reference FROM series WHERE seq IN ({listed})"
    found: dict[object, list[tuple[int, float]]] = defaultdict(list)
    for seq, run_id, parameter, baseline_id, reference in connection.execute(query):
        if baseline_id is not None and reference is not None:
            found[run_id, parameter, baseline_id].append((seq, reference))
    return {seq: (key, ref) for key, members in found.items() if len(members) > 1 for seq, ref in members}


Take = Callable[[str], int]
"""Gives the next number of a table."""
_NAMES = columns_of("covariates")
_LISTED = ", ".join(f"x.{name}" for name in _NAMES)
_OF_RIG = f"""SELECT {_LISTED} FROM covariates x JOIN runs r ON r.seq = x.run_id
 JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ? AND x.t_ns >= ? AND x.t_ns < ? ORDER BY x.seq"""
_NEWEST = """SELECT max(x.t_ns) FROM covariates x JOIN runs r ON r.seq = x.run_id
 JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ?"""
_OLD = (
    f"SELECT {_LISTED} FROM covariates x WHERE x.run_id = ? AND x.span = {MINUTE_S} AND x.t_ns < ? "
    "ORDER BY x.seq"
)


def means_of(connection: sqlite3.Connection, rig: str, first_ns: int, last_ns: int) -> list[CovariateMean]:
    """Return the means of a rig with first_ns <= t < last_ns as written; damaged rows are passed over."""
    return list(_sound(rig, connection.execute(_OF_RIG, (rig, first_ns, last_ns))))


def newest_means(connection: sqlite3.Connection, rig: str, span_ns: int) -> list[CovariateMean]:
    """Return the means of the newest stretch of a rig."""
    newest = connection.execute(_NEWEST, (rig,)).fetchone()[0]
    return [] if newest is None else means_of(connection, rig, newest - span_ns, newest + 1)


def _sound(rig: str, rows: Iterable[tuple[Any, ...]]) -> Iterable[CovariateMean]:
    for cells in map(checked, rows):
        if cells is not None:
            _, _, span, t_ns, name, unit, value, n = cells
            yield CovariateMean(rig, name, unit, t_ns, value, n, span)


def thin(connection: sqlite3.Connection, take: Take, minute_s: float, hour_s: float) -> None:
    """Make hours of minutes older than what is kept, and delete hours that are; inside a transaction.

    A run's age is counted back from its newest row.
    """
    newest = connection.execute("SELECT run_id, max(t_ns) FROM covariates GROUP BY run_id").fetchall()
    for run_id, now_ns in newest:
        if isfinite(hour_s):
            before = now_ns - round(hour_s * 1e9)
            connection.execute("DELETE FROM covariates WHERE run_id = ? AND t_ns < ?", (run_id, before))
        if isfinite(minute_s):
            _thin_run(connection, take, run_id, (now_ns - round(minute_s * 1e9)) // HOUR_NS * HOUR_NS)


def _thin_run(connection: sqlite3.Connection, take: Take, run_id: int, before: int) -> None:
    minutes = _sound("", connection.execute(_OLD, (run_id, before)).fetchall())
    hours: dict[tuple[str, str, int], tuple[float, int]] = {}
    for mean in minutes:
        key = mean.name, mean.unit, mean.t_ns // HOUR_NS * HOUR_NS
        total, n = hours.get(key, (0.0, 0))
        hours[key] = total + mean.value * mean.n, n + mean.n
    for (name, unit, t_ns), (total, n) in hours.items():
        cells = (take("covariates"), run_id, HOUR_S, t_ns, name, unit, total / n, n)
        connection.execute(insert_sql("covariates"), with_crc(cells))
    connection.execute(
        f"DELETE FROM covariates WHERE run_id = ? AND span = {MINUTE_S} AND t_ns < ?", (run_id, before)
    )
