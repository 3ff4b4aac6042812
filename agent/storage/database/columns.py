"""The columns of the store's tables, and the statements that put whole rows into them."""

import sqlite3
from collections.abc import Sequence
from functools import cache
from itertools import chain
from typing import TYPE_CHECKING

from agent.storage.database.checksum import column_crc
from agent.storage.tuning import ROWS_AT_ONCE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

COLUMN_BITS = 10
"""Fixed by the file's format: estimates.seq = hops.seq << COLUMN_BITS | column: estimates.seq = hops.seq <<
COLUMN_BITS | column."""

TABLES: dict[str, str] = {
    "meta": "key TEXT NOT NULL UNIQUE, value TEXT NOT NULL",
    "rigs": "name TEXT NOT NULL UNIQUE",
    "runs": "rig_id INTEGER NOT NULL, kind TEXT NOT NULL, started_ns INTEGER NOT NULL, "
    "code_version TEXT NOT NULL, config_sha256 TEXT NOT NULL, baseline_id INTEGER, boot_id TEXT, "
    "full_from_ns INTEGER, minute_from_ns INTEGER",
    "series": "run_id INTEGER NOT NULL, parameter TEXT NOT NULL, unit TEXT NOT NULL, method TEXT NOT NULL, "
    "reference REAL, baseline_id INTEGER",
    "fits": "window_s REAL, n_used INTEGER NOT NULL, n_missing INTEGER NOT NULL, dof REAL, t95 REAL, "
    "chosen INTEGER NOT NULL",
    "verdicts": "status TEXT NOT NULL, reason TEXT",
    "hops": "run_id INTEGER NOT NULL, span INTEGER NOT NULL, t_ns INTEGER NOT NULL",
    "estimates": "series_id INTEGER NOT NULL, fit_id INTEGER NOT NULL, verdict_id INTEGER NOT NULL, "
    "value REAL, sd REAL, lower REAL, upper REAL, held REAL, held_age_s REAL",
    "spreads": "n INTEGER NOT NULL, n_valid INTEGER NOT NULL, worst_id INTEGER NOT NULL, low REAL, high REAL",
    "overlaps": "run_id INTEGER NOT NULL, by_run INTEGER NOT NULL, from_ns INTEGER NOT NULL, "
    "to_ns INTEGER NOT NULL",
    "alarms": "run_id INTEGER NOT NULL, kind TEXT NOT NULL, parameter TEXT NOT NULL, priority TEXT NOT NULL, "
    "state TEXT NOT NULL, raised_ns INTEGER NOT NULL, cleared_ns INTEGER, acked_ns INTEGER, acked_by TEXT, "
    "shelved_until_ns INTEGER, delta REAL, sd REAL, limit_value REAL, probability REAL, "
    "message TEXT NOT NULL",
    "alarm_events": "alarm_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, from_state TEXT NOT NULL, "
    "to_state TEXT NOT NULL, cause TEXT NOT NULL, by_whom TEXT, comment TEXT",
    "health": "run_id INTEGER NOT NULL, source TEXT NOT NULL, t_ns INTEGER NOT NULL, "
    "received INTEGER NOT NULL, used INTEGER NOT NULL, rejected INTEGER NOT NULL, dropped INTEGER NOT NULL, "
    "gaps INTEGER NOT NULL, lag_s REAL, reasons TEXT",
    "events": "run_id INTEGER NOT NULL, source TEXT NOT NULL, t_ns INTEGER NOT NULL, cause TEXT NOT NULL, "
    "message TEXT NOT NULL",
    "counters": "name TEXT NOT NULL UNIQUE, count INTEGER NOT NULL",
    "sequences": "name TEXT NOT NULL UNIQUE, high INTEGER NOT NULL",
    "event_records": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, kind TEXT NOT NULL, "
    "parameter TEXT NOT NULL, alarms INTEGER NOT NULL, file TEXT NOT NULL, state TEXT NOT NULL, from_ns "
    "INTEGER NOT NULL, to_ns INTEGER NOT NULL, samples INTEGER NOT NULL, bytes INTEGER NOT NULL, baseline_id "
    "INTEGER, message TEXT NOT NULL",
    "learnt": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, key TEXT NOT NULL, content TEXT NOT NULL",
    "hypotheses": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, hypothesis TEXT NOT NULL, "
    "size REAL, sd REAL, unit TEXT NOT NULL, probability REAL",
    "clocks": "run_id INTEGER NOT NULL, part_of INTEGER NOT NULL, offset_ns INTEGER, "
    "from_ns INTEGER NOT NULL",
    "shelves": "alarm_id INTEGER NOT NULL, run_id INTEGER NOT NULL, boot_id TEXT, "
    "monotonic_ns INTEGER NOT NULL, t_ns INTEGER NOT NULL, length_ns INTEGER NOT NULL",
    "annotations": "alarm_id INTEGER NOT NULL, advice TEXT, percent REAL",
    "sites": "run_id INTEGER NOT NULL, site TEXT, labels TEXT",
    "graphs": "run_id INTEGER NOT NULL, graph TEXT NOT NULL",
    "baselines": "rig_id INTEGER NOT NULL, parameter TEXT NOT NULL, unit TEXT NOT NULL, graph TEXT NOT NULL, "
    "reference REAL, sd REAL, spread_sd REAL, within_sd REAL, days_sd REAL, correlation_s REAL, n_effective "
    "REAL, covariates TEXT NOT NULL, from_ns INTEGER NOT NULL, until_ns INTEGER NOT NULL, n INTEGER NOT NULL",
    "forecasts": "run_id INTEGER NOT NULL, parameter TEXT NOT NULL, made_ns INTEGER NOT NULL, level REAL, "
    "limit_value REAL, status TEXT NOT NULL, p10_ns INTEGER, p50_ns INTEGER, p90_ns INTEGER, chance REAL, "
    "horizon_s REAL, family TEXT NOT NULL, draws TEXT NOT NULL, cause TEXT NOT NULL, scored_ns INTEGER, "
    "crossed_ns INTEGER, crps REAL, held INTEGER",
    "notifications": "alarm_event_id INTEGER NOT NULL, target TEXT NOT NULL, state TEXT NOT NULL, "
    "attempts INTEGER NOT NULL, last_error TEXT, done_ns INTEGER",
    "covariates": "run_id INTEGER NOT NULL, span INTEGER NOT NULL, t_ns INTEGER NOT NULL, "
    "name TEXT NOT NULL, unit TEXT NOT NULL, value REAL NOT NULL, n INTEGER NOT NULL",
    "conditions": "run_id INTEGER NOT NULL, t_ns INTEGER NOT NULL, window_s REAL NOT NULL, defect REAL, "
    "defect_outputs REAL, rank INTEGER NOT NULL, rank_joined INTEGER NOT NULL, defect_special REAL, "
    "z_zero INTEGER NOT NULL, iterations INTEGER NOT NULL, converged INTEGER NOT NULL, cost REAL, step REAL, "
    "passes INTEGER NOT NULL, ratio REAL, trail TEXT NOT NULL",
    "trends": "run_id INTEGER NOT NULL, parameter TEXT NOT NULL, t_ns INTEGER NOT NULL, value REAL, sd REAL, "
    "slope_per_day REAL, slope_sd REAL, trend INTEGER NOT NULL",
}
"""Columns of each table between `seq INTEGER PRIMARY KEY` and `crc INTEGER NOT NULL`, as it was made."""
ADDED = {"estimates": ("repeat",)}
"""Columns, all REAL, that a later version added: after `crc` in the file and before it everywhere else."""


@cache
def columns_of(table: str) -> list[str]:
    """Return the columns of a table in order, with seq and crc."""
    return [
        "seq",
        *(part.strip().split()[0] for part in TABLES[table].split(",")),
        *ADDED.get(table, ()),
        "crc",
    ]


def numbers_crc(
    table: str, columns: "Sequence[NDArray[np.int64] | NDArray[np.float64]]"
) -> "NDArray[np.int32]":
    """Return the checksums of rows of a table of numbers, given as the columns before crc."""
    return column_crc(*columns, later=len(ADDED.get(table, ())))


@cache
def insert_sql(table: str, verb: str = "INSERT", rows: int = 1) -> str:
    """Return the statement that inserts whole rows of a table; verb: "INSERT" or "INSERT OR REPLACE"."""
    names = columns_of(table)
    values = f"({', '.join('?' * len(names))})"
    return f"{verb} INTO {table} ({', '.join(names)}) VALUES {', '.join([values] * rows)}"


def insert_rows(connection: sqlite3.Connection, table: str, rows: Sequence[tuple[object, ...]]) -> None:
    """Put whole rows into a table, in the place of those of the same number.

    Many go with one statement: while SQLite runs one, other threads of Python compute.
    """
    whole = len(rows) - len(rows) % ROWS_AT_ONCE
    for first in range(0, whole, ROWS_AT_ONCE):
        cells = tuple(chain.from_iterable(rows[first : first + ROWS_AT_ONCE]))
        connection.execute(insert_sql(table, "INSERT OR REPLACE", ROWS_AT_ONCE), cells)
    connection.executemany(insert_sql(table, "INSERT OR REPLACE"), rows[whole:])
