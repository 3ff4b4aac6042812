"""Stretches cut so that a piece of them holds few instants: a file of years is read without holding it."""

import sqlite3
from collections.abc import Mapping
from itertools import chain
from typing import Literal

from agent.storage.read.selection import Stretch

Asked = Mapping[str, list[Stretch]]
"""Stretches by rig."""
_NTH = """SELECT h.t_ns FROM hops h INDEXED BY hops_by_time
 WHERE h.run_id = ? AND h.span = ? AND h.t_ns BETWEEN ? AND ? ORDER BY h.t_ns {} LIMIT 1 OFFSET ?"""


def newest_instants(connection: sqlite3.Connection, asked: Asked, count: int) -> tuple[Asked, Asked]:
    """Return the newest part of stretches, in which one of them has `count` instants, and what is left."""
    found = _instants(connection, asked, count, "DESC")
    if not found:
        return asked, {}
    older, newer = _cut(asked, max(found))
    return newer, older


def oldest_instants(connection: sqlite3.Connection, asked: Asked, count: int) -> tuple[Asked, Asked]:
    """Return the oldest part of stretches, in which one of them has `count` instants, and what is left."""
    found = _instants(connection, asked, count, "ASC")
    return _cut(asked, min(found) + 1) if found else (asked, {})


def _instants(
    connection: sqlite3.Connection, asked: Asked, count: int, order: Literal["ASC", "DESC"]
) -> list[int]:
    """Return the true times (ns) at which stretches have their count-th instant, of those that have."""
    query = _NTH.format(order)
    return [
        row[0] + shift
        for part, shift, *ends in chain.from_iterable(asked.values())
        for span in (0, 60, 3600)
        if (row := connection.execute(query, (part, span, *ends, count - 1)).fetchone()) is not None
    ]


def _cut(asked: Asked, true_ns: int) -> tuple[Asked, Asked]:
    """Return what of stretches is before an instant of true time, and what is not."""
    before, after = dict[str, list[Stretch]](), dict[str, list[Stretch]]()
    for rig, stretches in asked.items():
        before[rig] = [s._replace(last=min(s.last, true_ns - s.shift - 1)) for s in stretches]
        after[rig] = [s.after(true_ns) for s in stretches]
    return _there(before), _there(after)


def _there(asked: Asked) -> Asked:
    """Return stretches without those that are empty."""
    return {rig: [s for s in stretches if s.first <= s.last] for rig, stretches in asked.items()}
