"""Minutes and hours: what is kept of estimates when the single rows are gone.

An aggregate is the information-weighted mean of the valid rows of a period. Windows that overlap share
samples, so a row counts for no more than the share of its window that is new since the row before; the mean's
standard deviation then is that of independent windows however densely rows were kept. What the rig's
constants leave open (sd beyond sd_repeat) is common to all rows: it is not averaged away.
"""

import sqlite3
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.storage.database.columns import COLUMN_BITS, numbers_crc
from agent.storage.tables.covariates import merged
from agent.storage.tables.estimates import ROW, repeat_cells
from agent.storage.tables.rows import Names, Numbers, Plan
from agent.storage.tuning import LEAST_SD, MOST_RECENT, NORMAL_DOF
from agent.types import BoolArray, FloatArray, IntArray, Status
from agent.units import MINUTE_S, SECOND_NS

_VALID = int(Status.VALID) << 8
_SEVERITY = {Status.VALID: 0, Status.WARMING: 1, Status.UNEXCITED: 2, Status.INVALID: 3}

_FULL_ROWS = """SELECT h.t_ns, e.series_id, e.verdict_id, e.value, e.sd, coalesce(f.window_s, 0),
 f.n_used, f.n_missing,
 coalesce(e.sd * e.repeat * 1e-4, e.sd)
 FROM hops h CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN fits f ON f.seq = e.fit_id
 WHERE h.run_id = ?1 AND h.span = ?2 AND h.t_ns < ?4 AND f.chosen = 1
 AND h.t_ns >= coalesce((SELECT max(t_ns) FROM hops WHERE run_id = ?1 AND span = ?2 AND t_ns < ?3), ?3)"""
"""With the rows just before the first: how much of a window is new depends on them."""

_MINUTE_ROWS = """SELECT h.t_ns, e.series_id, e.verdict_id, e.value, e.sd, coalesce(f.window_s, 0), f.n_used,
 f.n_missing, coalesce(e.sd * e.repeat * 1e-4, e.sd), p.n, p.n_valid, p.low, p.high, p.worst_id
 FROM hops h CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN fits f ON f.seq = e.fit_id
 CROSS JOIN spreads p ON p.seq = e.seq
 WHERE h.run_id = ? AND h.span = ? AND h.t_ns >= ? AND h.t_ns < ?"""

_MINUTES = np.dtype(
    [*ROW.descr, ("n", "i8"), ("n_valid", "i8"), ("low", "f8"), ("high", "f8"), ("worst", "i8")]
)


@dataclass(frozen=True, slots=True)
class Groups:
    """Aggregates, one a series and period; arrays of one length."""

    period_ns: IntArray
    series: IntArray
    value: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    low: FloatArray
    high: FloatArray
    n: IntArray
    n_valid: IntArray
    worst: IntArray
    window_s: FloatArray
    n_used: IntArray
    n_missing: IntArray


class Recent:
    """The newest rows of runs that began here, until minutes are made of them.

    To read them back costs a third of all that is written.
    """

    def __init__(self) -> None:
        self._rows: dict[int, list[NDArray[np.void]]] = {}
        self._waiting: dict[int, int] = {}

    def begin(self, run_id: int) -> None:
        """Take up a run that has no row yet."""
        self._waiting.setdefault(run_id, 0)

    def take(self, plan: Plan) -> None:
        """Take the rows of a plan that was committed, once; of a run with too many none is known any more."""
        for run_id, rows in plan.estimates:
            waiting = self._waiting.get(run_id, MOST_RECENT) + len(rows)
            self._waiting[run_id] = waiting
            if waiting < MOST_RECENT:
                self._rows.setdefault(run_id, []).append(rows)
            else:
                self._rows.pop(run_id, None)
        plan.estimates = []

    def between(self, run_id: int, first_ns: int, end_ns: int) -> NDArray[np.void] | None:
        """Return the rows of a run in first_ns <= t < end_ns with those just before; None if not known."""
        if run_id not in self._rows:
            return None
        rows = np.concatenate(self._rows[run_id])
        t_ns = rows["t_ns"]
        rows = rows[t_ns >= t_ns[t_ns < first_ns].max(initial=-(1 << 63))]
        self._rows[run_id] = [rows]
        self._waiting[run_id] = len(rows)
        return np.asarray(rows[rows["t_ns"] < end_ns])


def aggregate(
    connection: sqlite3.Connection, recent: Recent, run_id: int, span: int, first_ns: int, end_ns: int
) -> Groups | None:
    """Return the aggregates of a run in first_ns <= t < end_ns; minutes from rows, hours from minutes."""
    query, source = (_FULL_ROWS, 0) if span == MINUTE_S else (_MINUTE_ROWS, MINUTE_S)
    rows = None if source else recent.between(run_id, first_ns, end_ns)
    if rows is None:
        found = connection.execute(query, (run_id, source, first_ns, end_ns))
        rows = np.fromiter(found, dtype=_MINUTES if source else ROW)
    if not len(rows):
        return None
    rows["series"] = merged(connection, rows["t_ns"], rows["series"], span * SECOND_NS)
    rows = rows[np.lexsort((rows["t_ns"], rows["series"]))]
    columns = [rows[name] for name in rows.dtype.names or ()]
    if not source:
        value = rows["value"]
        verdict = rows["verdict"]
        columns += [np.ones(len(rows)), verdict == _VALID, value, value, verdict]
    return grouped(columns, span, source, first_ns)


def grouped(columns: Sequence[ArrayLike], span: int, source: int, first_ns: int) -> Groups | None:
    """Aggregate rows to periods.

    columns: t_ns, series, verdict, value, sd, window_s, n_used, n_missing, sd_repeat, n, n_valid, low, high,
    worst. The rows are in order of series, then time. span, source: lengths of the new periods and of the
    rows' own, s. first_ns: rows before it belong to no period; they only show what of a later window is new.
    None where there are no others.
    """
    share = _new_share(np.asarray(columns[0]), np.asarray(columns[1]), np.asarray(columns[5]), source)
    counted = np.asarray(columns[0]) >= first_ns
    if not counted.any():
        return None
    columns = [np.asarray(column)[counted] for column in columns]
    share = share[counted]
    t_ns, series, verdict = (np.array(c, dtype=np.int64) for c in columns[:3])
    value, sd, window = (np.array(c, dtype=np.float64) for c in columns[3:6])
    sd_repeat, low, high = (np.array(columns[place], dtype=np.float64) for place in (8, 11, 12))
    used, missing, n, n_valid, worst = (
        np.array(columns[place], dtype=np.int64) for place in (6, 7, 9, 10, 13)
    )
    period = (t_ns // (span * SECOND_NS)) * (span * SECOND_NS)
    starts = np.flatnonzero(np.r_[True, (series[1:] != series[:-1]) | (period[1:] != period[:-1])])
    valid = (verdict == _VALID) & np.isfinite(value) & np.isfinite(sd)
    mean, mean_repeat = _weighted(value, sd_repeat, share, valid, starts)
    with np.errstate(invalid="ignore"):
        common = np.sqrt(np.maximum(sd**2 - sd_repeat**2, 0.0))
    mean_sd = np.hypot(mean_repeat, _weighted(common, sd_repeat, share, valid, starts)[0])
    return Groups(
        period[starts], series[starts], mean, mean_sd, mean_repeat,
        _least(np.where(valid, low, np.nan), starts, np.fmin),
        _least(np.where(valid, high, np.nan), starts, np.fmax), np.add.reduceat(n, starts),
        np.add.reduceat(n_valid, starts), np.maximum.reduceat(_ranked(worst), starts) & 0xFFFF,
        np.maximum.reduceat(window, starts), np.add.reduceat(used, starts), np.add.reduceat(missing, starts),
    )  # fmt: skip


def _new_share(t_ns: IntArray, series: IntArray, window_s: FloatArray, source: int) -> FloatArray:
    """Return the share of each row's window that the row before it does not cover; 1 for aggregates."""
    share = np.ones(len(t_ns))
    if source == 0 and len(t_ns) > 1:
        step_s = np.diff(t_ns) / SECOND_NS
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(window_s[1:] > 0, step_s / window_s[1:], 1.0)
        share[1:] = np.where(series[1:] == series[:-1], np.clip(part, 0.0, 1.0), 1.0)
    return share


def _weighted(
    value: FloatArray, sd: FloatArray, share: FloatArray, valid: BoolArray, starts: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean and its sd in each group; NaN where no row is valid."""
    weight = np.where(valid, share / np.maximum(np.where(valid, sd, 1.0), LEAST_SD) ** 2, 0.0)
    total = np.add.reduceat(weight, starts)
    # Deviations from the group's first valid value are averaged: weights may differ by many powers of ten.
    anchor = np.repeat(
        _least(np.where(valid, value, np.nan), starts, np.fmin), np.diff(np.r_[starts, len(value)])
    )
    offset = np.where(valid, value - anchor, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = anchor[starts] + np.add.reduceat(weight * offset, starts) / total
        mean_sd = 1.0 / np.sqrt(total)
    return np.where(total > 0, mean, np.nan), np.where(total > 0, mean_sd, np.nan)


def _least(numbers: FloatArray, starts: IntArray, choose: np.ufunc) -> FloatArray:
    """Return the smallest or largest number of each group, passing over NaN."""
    found: FloatArray = choose.reduceat(numbers, starts)
    return found


def _ranked(verdict: IntArray) -> IntArray:
    """Return verdicts with their severity in the bits above, so that the greatest is the worst."""
    severity = np.array([_SEVERITY[status] for status in Status], dtype=np.int64)
    ranked: IntArray = (severity[np.minimum(verdict >> 8, len(severity) - 1)] << 16) | verdict
    return ranked


def add_groups(plan: Plan, groups: Groups, run_id: int, span: int, names: Names, numbers: Numbers) -> None:
    """Add aggregates to a plan: a hop a period, and in it a row a series."""
    order = np.lexsort((groups.series, groups.period_ns))
    period = groups.period_ns[order]
    fresh = np.r_[True, period[1:] != period[:-1]]
    hop = numbers.take("hops", int(fresh.sum())) + np.cumsum(fresh) - 1
    place = np.arange(len(period)) - np.maximum.accumulate(np.where(fresh, np.arange(len(period)), 0))
    _seal(plan, "hops", hop[fresh], np.full(fresh.sum(), run_id), np.full(fresh.sum(), span), period[fresh])
    seq = (hop << COLUMN_BITS) | place
    worst, valid = groups.worst[order], groups.n_valid[order]
    verdict = np.where(valid > 0, _VALID, worst)
    names.verdicts(set(np.unique(np.r_[verdict, worst]).tolist()))
    fits = zip(*(a[order].tolist() for a in (groups.window_s, groups.n_used, groups.n_missing)), strict=True)
    fit = np.array(
        [names.fit((window or None, used, lost, NORMAL_DOF, True, 1)) for window, used, lost in fits]
    )
    none = np.full(len(seq), np.nan)
    value, sd = groups.value[order], groups.sd[order]
    repeat = repeat_cells(sd, groups.sd_repeat[order])
    _seal(
        plan, "estimates", seq, groups.series[order], fit, verdict, value, sd, none, none, none, none, repeat
    )
    _seal(plan, "spreads", seq, groups.n[order], valid, worst, groups.low[order], groups.high[order])


def _seal(plan: Plan, table: str, *columns: NDArray[Any]) -> None:
    plan.add(table, *zip(*(c.tolist() for c in (*columns, numbers_crc(table, columns))), strict=True))
