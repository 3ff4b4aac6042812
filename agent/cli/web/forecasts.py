"""Stored forecasts as the page draws them: the newest beside those of the past, and how good those were."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.cli.glance.files import Watched
from agent.cli.prognosis.words import forecast_words, record_words
from agent.cli.tuning import KEPT_PARTS, MOST_PAST
from agent.runtime.forecasts.record import record_of
from agent.storage.read import queries, recent

Row = Mapping[str, Any]


def forecasts(databases: Iterable[Watched], rig: str | None, parameter: str | None) -> dict[str, Any]:
    """Return {"forecasts": rows of v_forecast without their draws, "records": one a parameter, "refused"}.

    A record says in `words` what the newest forecast is, and in `record_words` what became of earlier ones.
    Raises StoreError; UsageError for an unknown rig.
    """
    parts = [_kept(database, rig, parameter) for database in databases]
    return {
        "forecasts": [row for part in parts for row in part.rows],
        "records": [row for part in parts for row in part.records],
        "refused": sum(part.refused for part in parts),
    }


@dataclass(frozen=True, slots=True)
class _Part:
    """What one database says, and the mark of its forecasts when it said so."""

    mark: tuple[int, int, int]
    rows: list[Row]
    records: list[Row]
    refused: int


_parts: dict[tuple[Path, str | None, str | None], _Part] = {}


def _kept(database: Watched, rig: str | None, parameter: str | None) -> _Part:
    """Return what a database says; read anew when a forecast is made or scored, which is about hourly."""
    key = (database.path, rig, parameter)
    mark = recent.forecasts_mark(database.path)
    part = _parts.get(key)
    if part is None or part.mark != mark:
        if len(_parts) >= KEPT_PARTS:
            _parts.clear()
        part = _parts[key] = _read(database, rig, parameter, mark)
    return part


def _read(database: Watched, rig: str | None, parameter: str | None, mark: tuple[int, int, int]) -> _Part:
    found = queries.forecasts(database.path, rig, parameter)
    by_parameter = _by_parameter(found)
    rows = [_shown(row, database.name) for made in by_parameter for row in spread(made)]
    return _Part(mark, rows, [_record(made, database.name) for made in by_parameter], found.refused)


def _by_parameter(rows: Iterable[Row]) -> list[list[Row]]:
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["rig"], row["parameter"]), []).append(row)
    return list(found.values())


def spread(rows: list[Row], most: int = MOST_PAST) -> list[Row]:
    """Return at most so many rows, evenly spread, the last one always."""
    return rows[::-1][:: max(1, -(-len(rows) // most))][::-1]


def _shown(row: Row, name: str) -> Row:
    return {key: value for key, value in row.items() if key != "draws"} | {"db": name}


def _record(made: list[Row], name: str) -> Row:
    """Return what is said of one parameter's forecasts, oldest first."""
    newest = made[-1]
    record = record_of(made)
    return {
        "db": name,
        **{
            key: newest[key] for key in ("rig", "parameter", "limit_value", "status", "made_at", "made_at_ns")
        },
        **record,
        "words": words_of(newest),
        "record_words": record_words({"record": record}),
    }


def words_of(row: Row) -> str:
    """Say in a sentence what a row of v_forecast forecasts, counted from when it was made."""
    ahead = {f"{name}_s": _seconds(row, name) for name in ("p10", "p50", "p90")}
    is_dated = all(seconds is not None for seconds in ahead.values())
    status = "beyond" if row["status"] == "ok" and not is_dated else row["status"]
    forecast = {
        **ahead,
        "status": status,
        "chance": row["chance"],
        "horizon_s": row["horizon_s"],
        "like": None,
    }
    if not is_dated:
        forecast["p50_s"] = None
    return forecast_words({"forecast": forecast, "slope_per_day": None, "limit": row["limit_value"]})


def _seconds(row: Row, name: str) -> float | None:
    at = row[f"{name}_ns"]
    return None if at is None else (at - row["made_at_ns"]) / 1e9
