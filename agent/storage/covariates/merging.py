# ruff: noqa: S608 - statements are put together from numbers only
"""Rows of a parameter and baseline whose reference moved within a period, as one series: its middle one."""

import sqlite3
from collections import defaultdict

import numpy as np

from agent.types import IntArray


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
