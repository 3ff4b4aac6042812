# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Read-only questions to a database, answered in the columns of its views."""

import sqlite3
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from agent.errors import UsageError
from agent.storage.database.connect import Reader
from agent.storage.read.complete import oldest_hop, prove_count, prove_newest
from agent.storage.read.instants import Asked, newest_instants, oldest_instants
from agent.storage.read.proof import FIRST, LAST, prove_listed, proven, row_of
from agent.storage.read.selection import (
    Stretch,
    check_parameter,
    chosen_rigs,
    parameters_of,
    reading,
    rigs_of,
    stretches_of,
)
from agent.storage.tuning import INSTANTS_READ


class Rows(list[dict[str, Any]]):
    """Rows by column; refused: how many more there are, not shown because their checksums are wrong."""

    refused = 0


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
        asked = _asked(connection, rig, parameter, since, until)
        for own in asked.values():
            _check_count(connection, own, most)
        rows = _estimates(connection, asked, parameter)
        rows.refused = connection.refused
    return rows


def newest_estimates(
    db: Path | str, rig: str | None, parameter: str | None, since: str | None, until: str | None, count: int
) -> Rows:
    """Return the newest `count` rows of `estimates`, and no others from the file, which may hold a year."""
    with reading(db) as connection:
        asked: Asked = _asked(connection, rig, parameter, since, until)
        rows = Rows()
        instants = count
        while len(rows) < count and any(asked.values()):
            newer, asked = newest_instants(connection, asked, instants)
            rows[:0] = _estimates(connection, newer, parameter)
            instants *= 4  # those that came had no rows to show
        rows.refused = connection.refused
        del rows[: max(0, len(rows) - count)]
    return rows


def each_estimate(
    db: Path | str, rig: str | None, parameter: str | None, since: str | None, until: str | None
) -> Iterator[dict[str, Any]]:
    """Give the rows of `estimates` one after the other, however many there are; few are held at a time."""
    with reading(db) as connection:
        asked: Asked = _asked(connection, rig, parameter, since, until)
        prove_listed(connection, "hops", oldest_hop(connection, chain.from_iterable(asked.values())))
        while any(asked.values()):
            older, asked = oldest_instants(connection, asked, INSTANTS_READ)
            yield from _estimates(connection, older, parameter)


def _asked(
    connection: Reader, rig: str | None, parameter: str | None, since: str | None, until: str | None
) -> dict[str, list[Stretch]]:
    """Return the stretches asked for of each rig."""
    names = chosen_rigs(connection, rig)
    asked = {name: stretches_of(connection, name, since, until)[0] for name in names}
    check_parameter(connection, rig, parameter)
    return asked


def _estimates(connection: Reader, asked: Asked, parameter: str | None) -> Rows:
    """Return the rows of some rigs' stretches by time."""
    found: list[tuple[int, dict[str, Any]]] = []
    for name, stretches in asked.items():
        condition, values = _where(rig=name, parameter=parameter)
        first_hop = oldest_hop(connection, stretches)
        own = f"{condition} AND {row_of('r')} = ? AND t_ns BETWEEN ? AND ?"
        for stretch in stretches:
            part, shift, first, last = stretch
            refused = connection.refused
            rows = view_rows(
                connection, "v_estimates", own, (*values, part, first, last), first_hop=first_hop
            )
            prove_count(connection, stretch, rows, connection.refused - refused, parameter)
            found += [(row["t_ns"] + shift, row) for row in rows]
    found.sort(key=lambda pair: (pair[0], pair[1]["rig"]))
    return Rows(row for _, row in found)


def _check_count(connection: sqlite3.Connection, stretches: Sequence[Stretch], most: int | None) -> None:
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
        rigs = chosen_rigs(connection, rig)
        rows = view_rows(connection, "v_latest", *_where(rig=rig), first_hop=LAST)
        prove_newest(connection, rows, rigs)
        rows.refused = connection.refused
    return rows


def alarms(db: Path | str, rig: str | None = None, active: bool = False) -> Rows:
    """Return rows of v_alarms, oldest first; active: only those not back to normal."""
    return _of_rig(db, rig, "v_alarms", "id", " AND state <> 'NORM'" if active else "")


def notifications(db: Path | str, state: str | None = None) -> Rows:
    """Return rows of v_notifications, oldest first; state: only those pending, done or dead."""
    with reading(db) as connection:
        condition, values = _where(state=state)
        return view_rows(connection, "v_notifications", f"{condition} ORDER BY id", values)


def health(db: Path | str, rig: str | None = None) -> Rows:
    """Return each source's newest v_health row; `reasons`: {"rejected": {..}, "dropped": {..}} and faults."""
    with reading(db) as connection:
        chosen_rigs(connection, rig)
        newest: dict[tuple[str, str], dict[str, Any]] = {}
        condition, values = _where(rig=rig)
        for row in view_rows(connection, "v_health", f"{condition} ORDER BY {row_of('x')}", values):
            newest[row["rig"], row["source"]] = {**row, "reasons": {"rejected": {}, "dropped": {}}}
        for row in newest.values():
            condition, values = _where(rig=row["rig"], source=row["source"], t_ns=row["t_ns"])
            for reason in view_rows(connection, "v_health_reasons", condition, values):
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
    only = " AND scored_at IS NULL" if waiting else ""
    return _of_rig(db, rig, "v_forecast", "id", only, parameter=parameter)


def event_records(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_event_records, oldest first."""
    return _of_rig(db, rig, "v_event_records", "id")


def runs(db: Path | str, rig: str | None = None) -> Rows:
    """Return rows of v_runs, oldest first."""
    return _of_rig(db, rig, "v_runs", "run_id")


def _of_rig(
    db: Path | str, rig: str | None, view: str, order: str, only: str = "", **wanted: object
) -> Rows:  # fmt: skip
    """Return all rows of a view, or those of a rig; only, wanted: of these those that say so."""
    with reading(db) as connection:
        chosen_rigs(connection, rig)
        condition, values = _where(rig=rig, **wanted)
        return view_rows(connection, view, f"{condition}{only} ORDER BY {order}", values)


def rigs(db: Path | str) -> list[str]:
    """Return the names of the rigs that the file knows."""
    with reading(db) as connection:
        return rigs_of(connection)


def parameters(db: Path | str, rig: str | None = None) -> list[str]:
    """Return the names of the parameters that the file has rows of."""
    with reading(db) as connection:
        chosen_rigs(connection, rig)
        return parameters_of(connection, rig)


def _where(**wanted: object) -> tuple[str, tuple[object, ...]]:
    """Return a condition on the columns that have a value, and the values; names are this module's own."""
    known = {name: value for name, value in wanted.items() if value is not None}
    return " AND ".join(["1 = 1", *(f"{name} = ?" for name in known)]), tuple(known.values())


def view_rows(
    connection: Reader,
    view: str,
    condition: str,
    values: Sequence[object],
    numbered: str = "",
    first_hop: int = FIRST,
) -> Rows:
    """Return the rows of a view under a condition that prove themselves; arguments as of `proven`."""
    names, rows = proven(connection, view, condition, values, first_hop, numbered=numbered)
    found = Rows(dict(zip(names, cells, strict=True)) for cells in rows)
    found.refused = connection.refused
    return found
