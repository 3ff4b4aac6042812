"""Histories of a parameter in a database or table, what like machines teach, and a forecast as a document."""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from agent.errors import UsageError
from agent.prognosis.forecast import forecast, learn_from
from agent.prognosis.history import History, blocks, disjoint, sound
from agent.prognosis.learnt import Learnt
from agent.prognosis.posterior import FULL, Effort
from agent.prognosis.traces import Trace
from agent.runtime.forecasts.record import Row, record_of
from agent.runtime.tuning import HISTORY_MEANS
from agent.storage.read import queries
from agent.storage.read.points import Points, points_of
from agent.storage.read.tables import is_table, table_points
from agent.storage.read.times import age_ns
from agent.text import iso_time
from agent.units import DAY_NS

PRIOR = "deltak prior 1"
_LATEST_NS = 253_402_300_799 * 10**9
"""Fixed by ISO 8601: the end of the year 9999: what ISO 8601 can write."""


def history_of(points: Points, window_s: float) -> History:
    """Return rows without shared samples or outliers, or means of runs of them; t in days before now."""
    rows = disjoint(points.t_ns, np.maximum(points.span_s, window_s))
    if not len(rows):
        return History(np.empty(0), np.empty(0), np.empty(0))
    days = (points.t_ns[rows] - points.t_ns[-1]) / DAY_NS
    return blocks(sound(History(days, points.value[rows], points.sd_repeat[rows])), HISTORY_MEANS)


def common_sd(points: Points) -> float:
    """Return the sd of what the newest point shares with all the others."""
    return math.sqrt(max(float(points.sd[-1]) ** 2 - float(points.sd_repeat[-1]) ** 2, 0.0))


def window_s(db: Path, parameter: str) -> float:
    """Return the longest window that newest estimates of a parameter rest on."""
    rows = queries.latest(db)
    return max((row["window_s"] or 0.0 for row in rows if row["parameter"] == parameter), default=0.0)


def horizon_days(text: str | None, key: str = "--horizon") -> float | None:
    """Return an age such as "90d" in days; key: what named it. Raises UsageError for what is none."""
    if text is None:
        return None
    found = age_ns(text)
    if not found:
        raise UsageError.at(key, f'"{text}" is no length of time', "write 90d, 12h or 30min")
    return found / DAY_NS


def like_machines(
    paths: Sequence[Path], parameter: str | None, limit: float | None, key: str = "--like"
) -> Learnt | None:
    """Return what like machines teach: a prior file alone, or tables and databases with that parameter.

    key: what named them, for the words of errors.

    Raises UsageError where they teach nothing, StoreError for a database.
    """
    if not paths:
        return None
    if len(paths) == 1 and paths[0].suffix == ".json":
        return read_prior(paths[0])
    if any(path.suffix == ".json" for path in paths):
        raise UsageError.at(key, "a prior stands alone", "name one prior, or histories")
    histories = [history for path in paths for history in _histories(path, parameter)]
    try:
        return learn_from(histories, limit)
    except ValueError as error:
        raise UsageError.at(key, str(error), "name files with longer histories") from error


def _histories(path: Path, parameter: str | None) -> list[History]:
    if is_table(path):
        return [history_of(table_points(path, parameter=parameter)[0], 0.0)]
    if parameter is None:
        raise UsageError.at("--parameter", f"{path} holds several parameters", "name the one to learn from")
    window = window_s(path, parameter)
    return [history_of(points_of(path, rig, parameter), window) for rig in queries.rigs(path)]


def write_prior(learnt: Learnt, path: Path) -> None:
    """Write a prior. Raises UsageError for a place that cannot be written."""
    try:
        path.write_text(json.dumps({"kind": PRIOR, **asdict(learnt)}, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise UsageError.at(
            "--to", f"cannot write {path}: {error}", "name a file in a folder there is"
        ) from error


def read_prior(path: Path) -> Learnt:
    """Read a prior. Raises UsageError for a file that holds none."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["kind"] != PRIOR:
            raise ValueError("its kind is another")
        of = {name: (float(a), float(b), float(c)) for name, (a, b, c) in found["of"].items()}
        later = tuple((float(a), float(b), float(c)) for a, b, c in found["later"])
        traces = tuple(Trace(tuple(level), tuple(day)) for level, day in found.get("traces", ()))
        return Learnt(of, float(found["way"]), int(found["n"]), later, traces)
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        advice = "write one by deltak fleet learn"
        raise UsageError.at(path, f"holds no prior: {error}", advice) from error


def forecast_document(
    history: History, newest_ns: int, limit: float | None, horizon: float | None, like: Learnt | None,
    past: Sequence[Row] = (), effort: Effort = FULL,
) -> dict[str, Any] | None:  # fmt: skip
    """Return a forecast as it stands in JSON, beside those made in the past; None without a limit or row."""
    if limit is None or not len(history):
        return None
    found = forecast(history, limit, horizon, like, effort)
    ahead = {name: _seconds(getattr(found, name)) for name in ("p10", "p50", "p90")}
    return {
        "status": found.status,
        **{f"{name}_s": seconds for name, seconds in ahead.items()},
        **{f"{name}_at": _at(newest_ns, seconds) for name, seconds in ahead.items()},
        "chance": found.chance,
        "horizon_s": found.horizon * 86_400.0,
        "family": {name: round(weight, 4) for name, weight in found.family.items()},
        "like": None if like is None else {"histories": like.n},
        "record": record_of(past),
    }


def _seconds(days: float | None) -> float | None:
    return None if days is None or not math.isfinite(days) else days * 86_400.0


def _at(newest_ns: int, seconds: float | None) -> str | None:
    """Return an instant after the newest row; None past what a date can be."""
    if seconds is None:
        return None
    at = newest_ns + round(seconds * 1e9)
    return iso_time(at) if at <= _LATEST_NS else None
