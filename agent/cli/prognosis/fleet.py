"""`deltak fleet`: parts of many machines in one table, most urgent first; and what like machines teach."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from agent.cli.terminal.output import print_table, show
from agent.cli.tuning import FLEET_ROWS
from agent.errors import UsageError
from agent.prognosis.change import Change, change
from agent.prognosis.posterior import BRIEF
from agent.prognosis.steps import events, find_steps, without
from agent.runtime.forecasts.compensated import compensated
from agent.runtime.forecasts.histories import (
    forecast_document,
    history_of,
    horizon_days,
    like_machines,
    write_prior,
)
from agent.runtime.forecasts.record import record_of
from agent.runtime.forwarded.archive import ParquetHistories, is_archive
from agent.runtime.forwarded.postgres import PostgresHistories, is_address
from agent.storage.read import baselines, queries
from agent.storage.read.points import Points, all_points, longest_window
from agent.storage.read.tables import is_table, table_points
from agent.text import ahead, number, short_time
from agent.units import YEAR_DAYS

Document = Mapping[str, Any]


def fleet(
    places: Sequence[Path | str], within: str, parameter: str | None, limit_percent: float
) -> dict[str, Any]:
    """Return a row for each rig and parameter of databases, tables, archives and servers.

    Raises StoreError; UsageError for no place, or one that cannot be read.
    """
    horizon = horizon_days(within, "--within")
    rows = [
        _row(part, horizon, limit_percent) | {"covariates": list(part.covariates), "record": part.record}
        for place in places
        for part in _parts(place, parameter)
    ]
    rows.sort(key=lambda row: (-(row["chance"] or 0.0), -abs(row["slope_percent_per_year"] or 0.0)))
    return {"rows": rows, "within_s": horizon * 86_400.0 if horizon is not None else None}


def histories_in(place: Path) -> list[Path]:
    """Return a file, or a folder's databases, or where it has none its tables, in alphabetical order.

    Raises UsageError for a folder without either.
    """
    if not place.is_dir():
        return [place]
    found = sorted(place.glob("*.db")) or sorted(filter(is_table, place.iterdir()))
    if not found:
        raise UsageError.at(
            "DB",
            f"no .db file and no table in {place}",
            "name databases, tables, folders of them, Parquet archives, or postgresql://...",
        )
    return found


class _Part(NamedTuple):
    """One parameter of one rig: its points, the longest window of its rows, its limit, its past forecasts.

    covariates: those that were taken out of the points.
    """

    points: Points
    window_s: float
    limit: float | None
    record: Document | None
    covariates: tuple[str, ...] = ()


def _parts(place: Path | str, parameter: str | None) -> Iterator[_Part]:
    """Yield what is shown of one parameter or all of a place."""
    if isinstance(place, str) and is_address(place):
        yield from _forwarded(PostgresHistories(place), parameter)
    elif is_archive(Path(place)):
        yield from _forwarded(ParquetHistories(Path(place)), parameter)
    else:
        for path in histories_in(Path(place)):
            yield from _of_table(path, parameter) if is_table(path) else _stored(path, parameter)


def _of_table(path: Path, parameter: str | None) -> Iterator[_Part]:
    """Yield the one part of a table; nobody made forecasts of it."""
    points, _ = table_points(path, parameter=parameter)
    yield _Part(replace(points, parameter=parameter or points.parameter), 0.0, None, None)


def _stored(path: Path, parameter: str | None) -> Iterator[_Part]:
    """Yield the parts of the rigs of a database."""
    limits = {
        (a["rig"], a["parameter"]): a["limit_value"] for a in queries.alarms(path) if a["kind"] == "level"
    }
    past: dict[tuple[str, str], list[Document]] = {}
    for made in queries.forecasts(path):
        past.setdefault((made["rig"], made["parameter"]), []).append(made)
    window = longest_window(path)
    for rig in queries.rigs(path):
        standing = baselines.standing(path, rig)
        for points in all_points(path, rig, FLEET_ROWS):
            if parameter in {None, points.parameter}:
                key = rig, points.parameter
                same = compensated(path, points, standing)
                record = record_of(past.get(key, []))
                yield _Part(same.points, window, limits.get(key), record, tuple(same.covariates))


def _forwarded(histories: ParquetHistories | PostgresHistories, parameter: str | None) -> Iterator[_Part]:
    """Yield the parts of rigs whose rows were forwarded; of their forecasts nothing is known there."""
    for rig in histories.rigs:
        history = histories.history(rig, FLEET_ROWS)
        limits = histories.limits(rig)
        for points in history.points():
            if parameter in {None, points.parameter}:
                yield _Part(points, history.window_s, limits.get(points.parameter), None)


def _row(part: _Part, horizon: float | None, limit_percent: float) -> dict[str, Any]:
    """Return what is said of one parameter of one rig; a forecast only where there is a trend."""
    points = part.points
    row: dict[str, Any] = {
        "rig": points.rig, "parameter": points.parameter, "slope_percent_per_year": None, "trend": False,
        "limit": None, "status": "no trend", "p50_s": None, "p50_at": None, "chance": None,
    }  # fmt: skip
    history = history_of(points, part.window_s)
    asked = change(without(history, events(find_steps(history))))
    reference = points.reference if points.reference is not None else _first(points)
    if asked is None or reference is None:
        return row | {"status": "too short"}
    row["limit"] = limit = _limit(asked, reference, part.limit, limit_percent)
    if not asked.trend:
        return row
    if reference:
        row["slope_percent_per_year"] = 100.0 * YEAR_DAYS * asked.newest / abs(reference)
    row["trend"] = True
    found = forecast_document(history, int(points.t_ns[-1]), limit, horizon, None, effort=BRIEF) or {}
    return row | {name: found[name] for name in ("status", "p50_s", "p50_at", "chance") if name in found}


def _first(points: Points) -> float | None:
    return float(points.value[0]) if len(points.value) else None


def _limit(asked: Change, reference: float, alarm_limit: float | None, limit_percent: float) -> float:
    """Return the limit on the side that the parameter moves to."""
    way = alarm_limit if alarm_limit is not None else abs(reference) * limit_percent / 100.0
    return reference + (way if asked.newest > 0.0 else -way)


def print_fleet(found: Document) -> None:
    """Print the table for people."""
    rows = [
        (
            row["rig"], row["parameter"], number(row["slope_percent_per_year"], 3), number(row["limit"], 4),
            row["status"] if row["p50_s"] is None else f"in {ahead(row['p50_s'])}", short_time(row["p50_at"]),
            "-" if row["chance"] is None else f"{100.0 * row['chance']:.0f} %", _held(row["record"]),
        )
        for row in found["rows"]
    ]  # fmt: skip
    titles = ("rig", "parameter", "% a year", "limit", "reached", "P50", "chance", "held")
    numbers = ("% a year", "limit", "chance", "held")
    print_table(f"chance within {ahead(found['within_s'])}", titles, rows, right=numbers)


def _held(record: Document | None) -> str:
    """Say how many of the forecasts made there came as they said."""
    return f"{record['held']} of {record['made']}" if record and record["made"] else "-"


def learn_prior(
    files: Sequence[Path], parameter: str | None, limit: float | None, to: Path | None
) -> dict[str, Any]:
    """Learn a prior of like machines' histories and write it. Raises UsageError where they teach nothing."""
    if to is None:
        raise UsageError.at("--to", "is needed with learn", "name the file to write the prior to")
    if limit is not None and not math.isfinite(limit):
        raise UsageError.at("--limit", f"must be a number, not {limit:g}", "give a value of the parameter")
    paths = [path for file in files for path in histories_in(file)]
    learnt = like_machines(paths, parameter, limit, "DB")
    if learnt is None:
        raise UsageError.at("DB", "learn names no file", "name databases or tables of like machines")
    write_prior(learnt, to)
    return {
        "prior": str(to),
        "histories": learnt.n,
        "of": {name: list(cells) for name, cells in learnt.of.items()},
    }


def print_learnt(found: Document) -> None:
    """Print what was learnt of how many."""
    show(
        f"{found['prior']}: learnt of {found['histories']} histories; "
        f"use it by deltak trend --like {found['prior']}"
    )
