# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Read-only questions to a database, answered in the columns of its views."""

import logging
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.errors import Fault, UsageError
from agent.storage.database.connect import Reader, connect_reader, damaged, unreadable
from agent.storage.read.complete import oldest_hop, prove_count, prove_newest
from agent.storage.read.proof import (
    NOTHING,
    Found,
    differing,
    joined,
    prove_names,
    prove_parts,
    proven,
    row_of,
    series_of,
    sound_points,
)
from agent.storage.read.times import age_ns, parse_time
from agent.storage.tables.ages import newest_of, parts_of, shifts
from agent.types import FloatArray, IntArray

log = logging.getLogger(__name__)
_FIRST, _LAST = -(2**63), 2**63 - 1
_MOST_POINTS = 50_000  # more points than this and a trend reads a coarser tier
_UNCOUNTED = 2**40


class Rows(list[dict[str, Any]]):
    """Rows by column; refused: how many more there are, not shown because their checksums are wrong."""

    refused = 0


@dataclass(frozen=True, slots=True)
class Points:
    """Valid estimates of one parameter for a trend, in order of time.

    Attributes:
        rig, parameter, unit: what they are of.
        t_ns: (n,) times, by the wall clock as it is set now; of an aggregate, the middle of what it covers.
        value, sd: (n,) estimate and standard deviation.
        sd_repeat: (n,) standard deviation against the other points.
        span_s: (n,) 0, or what the aggregate covers.
        since_ns, until_ns: the stretch asked for; None where open.
        reference: what delta is counted from at the newest point; None without one.
        refused: rows that are left out because their checksums are wrong.
        references: what deltas were counted from over the stretch, oldest first.
        clock_steps: how often the wall clock was set otherwise meanwhile.
    """

    rig: str
    parameter: str
    unit: str
    t_ns: IntArray
    value: FloatArray
    sd: FloatArray
    sd_repeat: FloatArray
    span_s: IntArray
    since_ns: int | None
    until_ns: int | None
    reference: float | None
    refused: int
    references: tuple[float, ...] = ()
    clock_steps: int = 0


def tell_refused(db: Path | str, count: int) -> None:
    """Warn of rows that are not shown."""
    if count:
        words = "%s: %d rows are not shown, their checksums are wrong; `deltak db check` tells more"
        log.warning(words, db, count)


class _Stretch(NamedTuple):
    """Rows asked for: of a part of a run, from `first` to `last` (stamps, ns); stamp + shift is true time."""

    part: int
    shift: int
    first: int
    last: int

    def after(self, true_ns: int) -> "_Stretch":
        return self._replace(first=max(self.first, true_ns - self.shift))


@contextmanager
def reading(db: Path | str) -> Iterator[Reader]:
    """Open a database for one question; what SQLite finds wrong with it becomes a StoreError."""
    with closing(connect_reader(Path(db))) as connection:
        try:
            connection.execute("BEGIN")  # rows and what proves them are of one state
            prove_names(connection)
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
    *,
    most: int | None = None,
) -> Rows:
    """Return rows of v_estimates by time (by the wall clock's present setting), then rig and parameter.

    Args:
        db: path of the database.
        rig: None for all.
        parameter: None for all.
        since: first time, as typed (see `times.parse_time`); an age counts back from each rig's newest row.
        until: last time, inclusive.
        most: instants of a rig that may be asked for; None for any number.

    Raises:
        StoreError: the file; UsageError: an unknown rig or parameter, no time, or more instants than may be.
    """
    with reading(db) as connection:
        found: list[tuple[int, dict[str, Any]]] = []
        for name in _chosen_rigs(connection, rig):
            condition, values = _where(rig=name, parameter=parameter)
            stretches = _stretches(connection, name, since, until)[0]
            _check_count(connection, stretches, most)
            first_hop = oldest_hop(connection, stretches)
            own = f"{condition} AND {row_of('r')} = ? AND t_ns BETWEEN ? AND ?"
            for stretch in stretches:
                part, shift, first, last = stretch
                refused = connection.refused
                rows = _rows(connection, "v_estimates", own, (*values, part, first, last), first_hop)
                prove_count(connection, stretch, rows, connection.refused - refused, parameter)
                found += [(row["t_ns"] + shift, row) for row in rows]
        _check_parameter(connection, rig, parameter)
        found.sort(key=lambda pair: (pair[0], pair[1]["rig"]))
        rows = Rows(row for _, row in found)
        rows.refused = connection.refused
    return rows


def _check_count(connection: sqlite3.Connection, stretches: Sequence[_Stretch], most: int | None) -> None:
    """Raise UsageError where stretches have more instants than may be asked for; None: any number may."""
    if most is None:
        return
    rows = "FROM hops h WHERE h.run_id = ? AND h.span IN (0, 60, 3600) AND h.t_ns BETWEEN ? AND ? LIMIT ?"
    query = f"SELECT count(*) FROM (SELECT 1 {rows})"
    asked = ((part, first, last, most + 1) for part, _, first, last in stretches)
    if sum(connection.execute(query, cells).fetchone()[0] for cells in asked) > most:
        raise UsageError.at(
            "since", f"there are more than {most} instants in that time", "ask for less of it"
        )


def latest(db: Path | str, rig: str | None = None) -> Rows:
    """Return the newest row of each rig and parameter."""
    with reading(db) as connection:
        rigs = _chosen_rigs(connection, rig)
        rows = _rows(connection, "v_latest", *_where(rig=rig), _LAST)
        prove_newest(connection, rows, rigs)
        rows.refused = connection.refused
    return rows


def alarms(db: Path | str, rig: str | None = None, active: bool = False) -> Rows:
    """Return rows of v_alarms, oldest first; active: only those not back to normal."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        if active:
            condition += " AND state <> 'NORM'"
        return _rows(connection, "v_alarms", f"{condition} ORDER BY id", values)


def alarm_events(db: Path | str) -> Rows:
    """Return rows of v_alarm_events, oldest first."""
    with reading(db) as connection:
        return _rows(connection, "v_alarm_events", "1 = 1 ORDER BY id", ())


def notifications(db: Path | str, state: str | None = None) -> Rows:
    """Return rows of v_notifications, oldest first; state: only those pending, done or dead."""
    with reading(db) as connection:
        condition, values = _where(state=state)
        return _rows(connection, "v_notifications", f"{condition} ORDER BY id", values)


def health(db: Path | str, rig: str | None = None) -> Rows:
    """Return each source's newest v_health row; `reasons`: {"rejected": {..}, "dropped": {..}} and faults."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        newest: dict[tuple[str, str], dict[str, Any]] = {}
        condition, values = _where(rig=rig)
        for row in _rows(connection, "v_health", f"{condition} ORDER BY {row_of('x')}", values):
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
    return _of_rig(db, rig, "v_events", "id")


def verdicts(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_verdicts, oldest first."""
    return _of_rig(db, rig, "v_verdicts", "t_ns, run_id")


def conditions(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_conditions, oldest first."""
    return _of_rig(db, rig, "v_conditions", "id")


def forecasts(
    db: Path | str, rig: str | None = None, parameter: str | None = None, *, waiting: bool = False
) -> Rows:
    """Return rows of v_forecast, oldest first; waiting: only those that are not scored yet."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig, parameter=parameter)
        if waiting:
            condition += " AND scored_at IS NULL"
        return _rows(connection, "v_forecast", f"{condition} ORDER BY id", values)


def event_records(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_event_records, oldest first."""
    return _of_rig(db, rig, "v_event_records", "id")


def runs(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_runs, oldest first."""
    return _of_rig(db, rig, "v_runs", "run_id")


def _of_rig(db: Path | str, rig: str | None, view: str, order: str) -> Rows:
    """Return all rows of a view, or those of a rig."""
    with reading(db) as connection:
        _chosen_rigs(connection, rig)
        condition, values = _where(rig=rig)
        return _rows(connection, view, f"{condition} ORDER BY {order}", values)


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
    db: Path | str, rig: str | None, parameter: str, since: str | None = None, until: str | None = None,
    most: int = _MOST_POINTS,
) -> Points:  # fmt: skip
    """Return the valid estimates of one parameter as arrays.

    Stretches of more than `most` rows are read from the hourly or minutely rows, so that a year takes
    milliseconds; where there are too many hours, every second, third ... is.

    Raises:
        StoreError: the file; UsageError: an unknown rig or parameter, a rig needed because there are several,
            no time.
    """
    with reading(db) as connection:
        name = _one_rig(connection, rig)
        _check_parameter(connection, name, parameter)
        return _points(connection, name, (parameter,), since, until, most)[0]


def all_points(db: Path | str, rig: str, most: int = _MOST_POINTS) -> list[Points]:
    """Return the same of every parameter of a rig, whose rows are read together; errors as `points`."""
    with reading(db) as connection:
        name = _one_rig(connection, rig)
        return _points(connection, name, _parameters(connection, name), None, None, most)


def longest_window(db: Path | str) -> float:
    """Return the longest window, s, that estimates of a database rest on; quicker than looking those up."""
    query = (
        "SELECT seq, window_s FROM fits WHERE chosen = 1 AND window_s IS NOT NULL "
        "ORDER BY window_s DESC LIMIT 1"
    )
    with reading(db) as connection:
        found = connection.execute(query).fetchone()
        connection.refuse(0 if found is None else len(differing(connection, "fits", (), {found[:1]})))
    return 0.0 if found is None else float(found[1])


def _points(
    connection: Reader, rig: str, names: Sequence[str], since: str | None, until: str | None, most: int
) -> list[Points]:
    stretches, first, last = _stretches(connection, rig, since, until)
    parts = {stretch.part for stretch in stretches}
    series = {name: {p: n for p, n in series_of(connection, name).items() if p in parts} for name in names}
    together: dict[int, list[int]] = {}
    for runs_of_one in series.values():
        for part, numbers in runs_of_one.items():
            together.setdefault(part, []).extend(numbers)
    rows, spans = _tiered(connection, stretches, together, most)
    found = []
    for name in names:
        own = [number for numbers in series[name].values() for number in numbers]
        mine = np.isin(rows.series, own)
        one = rows.at(mine)
        unit, reference = _unit(connection, rig, name)
        found.append(Points(
            rig, name, unit, one.t_ns, one.value, one.sd, one.sd_repeat, spans[mine],
            None if since is None else first, None if until is None else last, reference, connection.refused,
            _references(connection, own), max(0, len({s.shift for s in stretches}) - 1),
        ))  # fmt: skip
    return found


def _tiered(
    connection: Reader, stretches: Sequence[_Stretch], series: Mapping[int, Sequence[int]], most: int
) -> tuple[Found, IntArray]:
    """Return rows from the finest tier that is not too long, then finer ones, and what each covers, s."""
    bounds = {
        span: _bounds(connection, stretches, span, most if span < 3600 else _UNCOUNTED)
        for span in (0, 60, 3600)
    }
    start = _first_tier(bounds, most)
    tiers: list[Found] = []
    spans = sorted((s for s in bounds if s <= start), reverse=True)
    for span in spans:
        _, count = bounds[span] or (0, 0)
        each = max(1, -(-count // most)) if span == 3600 else 1
        tiers.append(_tier_points(connection, stretches, series, span, each))
        if len(tiers[-1].t_ns):
            reached = int(tiers[-1].t_ns[-1]) + span * 500_000_000 + (span == 0)
            stretches = [stretch.after(reached) for stretch in stretches]
    return joined(tiers), np.repeat(spans, [len(tier.t_ns) for tier in tiers])


def _first_tier(bounds: Mapping[int, tuple[int, int] | None], most: int) -> int:
    """Return the finest tier that reaches far enough and is not too long, else the coarsest with rows."""
    oldest = min((b[0] for b in bounds.values() if b), default=0)
    fits = [s for s, b in bounds.items() if b and b[0] <= oldest + (s or 3600) * 10**9 and b[1] <= most]
    return fits[0] if fits else max((span for span, b in bounds.items() if b), default=0)


def _bounds(
    connection: sqlite3.Connection, stretches: Sequence[_Stretch], span: int, most: int
) -> tuple[int, int] | None:
    """Return a tier's oldest instant in stretches and how many it has there, counted as far as matters."""
    part = "FROM hops h WHERE h.run_id = ?1 AND h.span = ?2 AND h.t_ns BETWEEN ?3 AND ?4"
    query = (
        f"SELECT (SELECT h.t_ns {part} ORDER BY h.t_ns LIMIT 1), "
        f"(SELECT count(*) FROM (SELECT 1 {part} LIMIT ?5))"
    )
    found = []
    for stretch, shift, first, last in stretches:
        oldest, count = connection.execute(query, (stretch, span, first, last, most + 1)).fetchone()
        found += [(oldest + shift, count)] if count else []
    return (min(t for t, _ in found), sum(n for _, n in found)) if found else None


def _tier_points(
    connection: Reader,
    stretches: Sequence[_Stretch],
    series: Mapping[int, Sequence[int]],
    span: int,
    each: int,
) -> Found:
    """Return the points of a tier in the order of true time."""
    found = [NOTHING]
    for part, shift, first, last in stretches:
        points = sound_points(connection, part, series.get(part, ()), span, first, last, each)
        found.append(points._replace(t_ns=points.t_ns + shift))
    rows = joined(found)
    return rows.at(np.argsort(rows.t_ns, kind="stable"))


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


def _references(connection: sqlite3.Connection, series: Sequence[int]) -> tuple[float, ...]:
    """Return the different references of some series, oldest first."""
    query = f"SELECT reference FROM series WHERE seq IN ({', '.join(map(str, series))}) ORDER BY seq"
    known = (reference for (reference,) in connection.execute(query) if reference is not None)
    return tuple(dict.fromkeys(known))


def _where(**wanted: object) -> tuple[str, tuple[object, ...]]:
    """Return a condition on the columns that have a value, and the values; names are this module's own."""
    known = {name: value for name, value in wanted.items() if value is not None}
    return " AND ".join(["1 = 1", *(f"{name} = ?" for name in known)]), tuple(known.values())


def _rows(
    connection: Reader, view: str, condition: str, values: Sequence[object], first_hop: int = _FIRST
) -> Rows:
    names, rows = proven(connection, view, condition, values, first_hop)
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
        raise UsageError(
            [Fault("--rig", what, f"name one of {_list(known)}" if known else "let the agent run first")]
        )
    return known[0]


def _check_parameter(connection: sqlite3.Connection, rig: str | None, parameter: str | None) -> None:
    known = _parameters(connection, rig)
    if parameter is not None and parameter not in known:
        raise UsageError(
            [
                Fault(
                    "parameter",
                    f'the database has no parameter "{parameter}"',
                    f"parameters are {_list(known)}",
                )
            ]
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none yet"


def _stretches(
    connection: Reader, rig: str, since: str | None, until: str | None
) -> tuple[list[_Stretch], int, int]:
    """Return what was asked for by run part, and its first and last instant (ns); open ends reach far enough.

    An age counts in true time back from the newest row, a date is compared with the stamps as they are.
    """
    parts = parts_of(connection, rig)
    prove_parts(connection, rig, parts)
    shift = shifts(parts)
    newest = newest_of(parts, shift)
    first = _FIRST if since is None else min(parse_time(since, newest, "--since"), _LAST)
    last = _LAST if until is None else max(parse_time(until, newest, "--until"), _FIRST)
    if first > last:
        raise UsageError([Fault("--since", f'"{since}" is later than --until "{until}"', "swap them")])
    by_age = [text is not None and age_ns(text) is not None for text in (since, until)]
    found = []
    for part in parts:
        ends = [t - shift[part.seq] if age else t for t, age in zip((first, last), by_age, strict=True)]
        found.append(_Stretch(part.seq, shift[part.seq], *(min(max(t, _FIRST), _LAST) for t in ends)))
    return found, first, last
