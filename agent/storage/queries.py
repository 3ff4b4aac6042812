# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Read-only questions to a database, answered in the columns of its views."""

import logging
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.errors import Fault, UsageError
from agent.storage.connect import Reader, connect_reader, damaged, unreadable
from agent.storage.proof import differing, point_columns, points_of, prove_whole, proven, sound_points
from agent.storage.times import parse_time
from agent.types import FloatArray, IntArray

log = logging.getLogger(__name__)
_MOST_POINTS = 50_000  # more points than this and a trend reads a coarser tier


class Rows(list[dict[str, Any]]):
    """Rows by column; refused: how many more there are, which are not shown because their checksums are wrong."""

    refused = 0


@dataclass(frozen=True, slots=True)
class Points:
    """Valid estimates of one parameter for a trend, in order of time.

    Attributes:
        rig, parameter, unit: what they are of.
        t_ns: (n,) times; of an aggregate, the middle of what it covers.
        value, sd: (n,) estimate and standard deviation.
        span_s: (n,) 0, or what the aggregate covers.
        since_ns, until_ns: the stretch asked for; None where open.
        reference: what delta is counted from at the newest point; None without one.
        refused: rows that are left out because their checksums are wrong.
    """

    rig: str
    parameter: str
    unit: str
    t_ns: IntArray
    value: FloatArray
    sd: FloatArray
    span_s: IntArray
    since_ns: int | None
    until_ns: int | None
    reference: float | None
    refused: int


def tell_refused(db: Path | str, count: int) -> None:
    """Warn of rows that are not shown."""
    if count:
        words = "%s: %d rows are not shown, their checksums are wrong; `deltak db check` tells more"
        log.warning(words, db, count)


@contextmanager
def reading(db: Path | str) -> Iterator[Reader]:
    """Open a database for one question; what SQLite finds wrong with it becomes a StoreError."""
    with closing(connect_reader(Path(db))) as connection:
        try:
            connection.execute("BEGIN")  # rows and what proves them are of one state
            yield connection
            tell_refused(db, connection.refused)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise unreadable(Path(db), error) from error


def estimates(
    db: Path | str,
    rig: str | None = None,
    parameter: str | None = None,
    since: str | None = None,
    until: str | None = None,
) -> Rows:
    """Return rows of v_estimates by time, then rig and parameter.

    Args:
        db: path of the database.
        rig: None for all.
        parameter: None for all.
        since: first time, as typed (see `times.parse_time`); an age counts back from each rig's newest row.
        until: last time, inclusive.

    Raises:
        StoreError: the file; UsageError: an unknown rig or parameter, or no time.
    """
    with reading(db) as connection:
        found = Rows()
        for name in _chosen_rigs(connection, rig):
            first, last = _stretch(connection, name, since, until)
            condition, values = _where(rig=name, parameter=parameter)
            condition += " AND t_ns BETWEEN ? AND ?"
            found += _rows(connection, "v_estimates", condition, (*values, first, last))
        _check_parameter(connection, rig, parameter)
        found.refused = connection.refused
    found.sort(key=lambda row: (row["t_ns"], row["rig"]))
    return found


def latest(db: Path | str, rig: str | None = None) -> Rows:
    """Return the newest row of each rig and parameter."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        return _rows(connection, "v_latest", *_where(rig=rig))


def alarms(db: Path | str, rig: str | None = None, active: bool = False) -> Rows:
    """Return rows of v_alarms, oldest first; active: only those not back to normal."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        if active:
            condition += " AND state <> 'NORM'"
        return _rows(connection, "v_alarms", f"{condition} ORDER BY id", values)


def health(db: Path | str, rig: str | None = None) -> Rows:
    """Return the newest row of v_health of each source; `reasons` is {"rejected": {..}, "dropped": {..}} and faults."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        newest: dict[tuple[str, str], dict[str, Any]] = {}
        for row in _rows(connection, "v_health", *_where(rig=rig)):
            newest[row["rig"], row["source"]] = {**row, "reasons": {"rejected": {}, "dropped": {}}}
        for row in newest.values():
            condition, values = _where(rig=row["rig"], source=row["source"], t_ns=row["t_ns"])
            for reason in _rows(connection, "v_health_reasons", condition, values):
                row["reasons"].setdefault(reason["kind"], {})[reason["reason"]] = reason["count"]
        found = Rows(newest.values())
        found.refused = connection.refused
    return found


def events(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_events, oldest first."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        return _rows(connection, "v_events", f"{condition} ORDER BY id", values)


def event_records(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_event_records, oldest first."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        return _rows(connection, "v_event_records", f"{condition} ORDER BY id", values)


def runs(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_runs, oldest first."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        return _rows(connection, "v_runs", f"{condition} ORDER BY run_id", values)


def rigs(db: Path | str) -> list[str]:
    """Return the names of the rigs that the file knows."""
    with reading(db) as connection:
        return _rigs(connection)


def parameters(db: Path | str, rig: str | None = None) -> list[str]:
    """Return the names of the parameters that the file has rows of."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        return _parameters(connection, rig)


def points(
    db: Path | str, rig: str | None, parameter: str, since: str | None = None, until: str | None = None
) -> Points:
    """Return the valid estimates of one parameter as arrays.

    Long stretches are read from the hourly or minutely rows, so that a year takes milliseconds.

    Raises:
        StoreError: the file; UsageError: an unknown rig or parameter, a rig needed because there are several, no time.
    """
    with reading(db) as connection:
        name = _one_rig(connection, rig)
        _check_parameter(connection, name, parameter)
        first, last = _stretch(connection, name, since, until)
        found = _tiered(connection, name, parameter, first, last)
        unit, reference = _unit(connection, name, parameter)
        refused = connection.refused
    t_ns, value, sd, span = (np.array(column) for column in (zip(*found, strict=True) if found else ((), (), (), ())))
    return Points(
        name, parameter, unit, t_ns.astype(np.int64), value.astype(np.float64), sd.astype(np.float64),
        span.astype(np.int64), None if since is None else first, None if until is None else last, reference, refused,
    )  # fmt: skip


def _tiered(connection: Reader, rig: str, parameter: str, first: int, last: int) -> list[tuple[Any, ...]]:
    """Return (t_ns, value, sd, span_s) from the finest tier that reaches back and is not too long, then finer rows."""
    bounds = {span: _bounds(connection, rig, span, first, last) for span in (0, 60, 3600)}
    oldest = min((b[0] for b in bounds.values() if b), default=first)
    fits = [s for s, b in bounds.items() if b and b[0] <= oldest + (s or 3600) * 10**9 and b[1] <= _MOST_POINTS]
    start = fits[0] if fits else max((span for span, b in bounds.items() if b), default=0)
    found: list[tuple[Any, ...]] = []
    for span in sorted((s for s in bounds if s <= start), reverse=True):
        found += _tier_points(connection, rig, parameter, span, first, last)
        if found:
            first = max(first, found[-1][0] + span * 500_000_000 + (span == 0))
    return found


def _bounds(connection: sqlite3.Connection, rig: str, span: int, first: int, last: int) -> tuple[int, int] | None:
    """Return the oldest instant of a tier in a stretch and how many it has there, counted no further than matters."""
    part = "FROM hops h WHERE h.run_id = r.seq AND h.span = ?2 AND h.t_ns BETWEEN ?3 AND ?4"
    query = (
        f"SELECT min(t), sum(n) FROM (SELECT (SELECT h.t_ns {part} ORDER BY h.t_ns LIMIT 1) AS t, "
        f"(SELECT count(*) FROM (SELECT 1 {part} LIMIT ?5)) AS n "
        "FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq WHERE g.name = ?1)"
    )
    oldest, count = connection.execute(query, (rig, span, first, last, _MOST_POINTS + 1)).fetchone()
    return (oldest, count) if count else None


def _tier_points(
    connection: Reader, rig: str, parameter: str, span: int, first: int, last: int
) -> list[tuple[Any, ...]]:
    query = (
        f"SELECT {point_columns()} FROM rigs g CROSS JOIN runs r ON r.rig_id = g.seq "
        "CROSS JOIN hops h ON h.run_id = r.seq "
        "CROSS JOIN estimates e ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023 "
        "CROSS JOIN series s ON s.seq = e.series_id CROSS JOIN fits f ON f.seq = e.fit_id "
        "WHERE g.name = ? AND s.parameter = ? AND h.span = ? AND h.t_ns BETWEEN ? AND ? AND e.verdict_id = 256 "
        "AND f.chosen = 1 AND e.value IS NOT NULL AND NOT EXISTS (SELECT 1 FROM overlaps o WHERE o.run_id = h.run_id "
        "AND h.t_ns BETWEEN o.from_ns AND o.to_ns) ORDER BY h.t_ns"
    )
    rows = connection.execute(query, (rig, parameter, span, first, last)).fetchall()
    prove_whole(connection, "overlaps")
    return points_of(sound_points(connection, rig, rows))


def _unit(connection: Reader, rig: str, parameter: str) -> tuple[str, float | None]:
    query = (
        "SELECT s.unit, s.reference, s.seq FROM series s JOIN runs r ON r.seq = s.run_id "
        "JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ? AND s.parameter = ? ORDER BY s.seq DESC LIMIT 1"
    )
    row = connection.execute(query, (rig, parameter)).fetchone()
    if row is None:  # found a moment ago, by another way
        raise damaged("an index does not list what its table holds")
    unit, reference, seq = row
    connection.refuse(len(differing(connection, "series", (), {(seq,)})))
    return str(unit), None if reference is None else float(reference)


def _where(**wanted: object) -> tuple[str, tuple[object, ...]]:
    """Return a condition on the columns that have a value, and the values; names are this module's own."""
    known = {name: value for name, value in wanted.items() if value is not None}
    return " AND ".join(["1 = 1", *(f"{name} = ?" for name in known)]), tuple(known.values())


def _rows(connection: Reader, view: str, condition: str, values: Sequence[object]) -> Rows:
    names, rows = proven(connection, view, condition, values)
    found = Rows(dict(zip(names, cells, strict=True)) for cells in rows)
    found.refused = connection.refused
    return found


def _rigs(connection: sqlite3.Connection) -> list[str]:
    return [name for (name,) in connection.execute("SELECT name FROM rigs ORDER BY seq")]


def _parameters(connection: sqlite3.Connection, rig: str | None) -> list[str]:
    query = (
        "SELECT s.parameter FROM series s JOIN runs r ON r.seq = s.run_id JOIN rigs g ON g.seq = r.rig_id "
        "WHERE ?1 IS NULL OR g.name = ?1 GROUP BY s.parameter ORDER BY min(s.seq)"
    )
    return [name for (name,) in connection.execute(query, (rig,))]


def _chosen_rigs(connection: sqlite3.Connection, rig: str | None) -> list[str]:
    """Return the rigs meant; UsageError for one that the file does not know."""
    known = _rigs(connection)
    if rig is None:
        return known
    if rig not in known:
        raise UsageError([Fault("--rig", f'the database has no rig "{rig}"', f"rigs are {_list(known)}")])
    return [rig]


def _one_rig(connection: sqlite3.Connection, rig: str | None) -> str:
    known = _chosen_rigs(connection, rig)
    if len(known) != 1:
        what = "the database has several rigs" if known else "the database has no rows yet"
        raise UsageError([Fault("--rig", what, f"name one of {_list(known)}" if known else "let the agent run first")])
    return known[0]


def _check_parameter(connection: sqlite3.Connection, rig: str | None, parameter: str | None) -> None:
    known = _parameters(connection, rig)
    if parameter is not None and parameter not in known:
        raise UsageError(
            [Fault("parameter", f'the database has no parameter "{parameter}"', f"parameters are {_list(known)}")]
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none yet"


def _stretch(connection: sqlite3.Connection, rig: str, since: str | None, until: str | None) -> tuple[int, int]:
    """Return the first and last instant (ns) asked for; open ends reach as far as integers do."""
    newest = connection.execute(
        "SELECT max((SELECT t_ns FROM hops h WHERE h.run_id = r.seq AND h.span = 0 ORDER BY t_ns DESC LIMIT 1)) "
        "FROM runs r JOIN rigs g ON g.seq = r.rig_id WHERE g.name = ?",
        (rig,),
    ).fetchone()[0]
    first = -(2**63) if since is None else parse_time(since, newest)
    last = 2**63 - 1 if until is None else parse_time(until, newest)
    if first > last:
        raise UsageError([Fault("--since", f'"{since}" is later than --until "{until}"', "swap them")])
    return first, last
