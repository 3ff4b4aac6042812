"""`deltak trend`: whether a parameter changes and when it reaches a limit, as text, JSON, CSV or picture."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.prognosis.picture import draw
from agent.cli.prognosis.words import drift, finding, forecast_words, record_words, unit_of, verdict
from agent.cli.terminal.output import print_csv, print_json, print_table, show
from agent.errors import UsageError
from agent.prognosis.change import Change, change
from agent.prognosis.history import disjoint
from agent.prognosis.steps import events, find_steps, without
from agent.runtime.forecasts.compensated import Compensated, compensated
from agent.runtime.forecasts.histories import (
    common_sd,
    forecast_document,
    history_of,
    horizon_days,
    like_machines,
    window_s,
)
from agent.storage.read import queries
from agent.storage.read.points import Points, points_of
from agent.storage.read.tables import is_table, table_points
from agent.text import behind, counted, iso_time, number, short_time, with_sd
from agent.units import DAY_NS

Document = Mapping[str, Any]
_BARS = "▁▂▃▄▅▆▇█"


@dataclass(frozen=True, slots=True)
class Ahead:
    """What is asked of the future: like machines, how far ahead, and the value a limit is counted from."""

    like: tuple[Path, ...] = ()
    horizon: str | None = None
    reference: float | None = None


def trend(
    db: Path,
    parameter: str | None,
    rig: str | None,
    times: tuple[str | None, str | None],
    limit: float | None,
    form: str,
    plot: Path | None,
    ahead: Ahead | None = None,
) -> None:
    """Print a parameter's trend. Raises StoreError; UsageError for a bad parameter, rig, time or picture."""
    if parameter is None and not is_table(db):
        _print_all(db, rig, times, form)
        return
    ahead = ahead or Ahead()
    document, past = _asked(db, parameter, rig, times, _limit_of(limit, ahead.reference), ahead)
    if plot is not None:
        draw(document, plot, past)
    _print(document, form)


def document(
    db: Path, parameter: str, rig: str | None, times: tuple[str | None, str | None], limit: float | None
) -> dict[str, Any]:
    """Return the document of one database history, as --json prints it. Raises StoreError, UsageError."""
    return _asked(db, parameter, rig, times, limit, Ahead())[0]


def _limit_of(limit: float | None, reference: float | None) -> float | None:
    """Return the limit as a value of the parameter. Raises UsageError where it is no number."""
    if limit is not None and not math.isfinite(limit):
        raise UsageError.at(
            "--limit", f"must be a number, not {limit:g}", "give a value of the parameter, in its unit"
        )
    return limit if limit is None or reference is None else limit + reference


def _asked(
    db: Path, parameter: str | None, rig: str | None, times: tuple[str | None, str | None],
    limit: float | None,
    ahead: Ahead,
) -> tuple[dict[str, Any], Sequence[Document]]:  # fmt: skip
    """Return what is said of one history, of a database or a table, and the agent's forecasts of it."""
    if parameter is not None and not is_table(db):
        found = compensated(db, points_of(db, rig, parameter, *times))
        past = queries.forecasts(db, found.points.rig, parameter)
        return _document(found, window_s(db, parameter), limit, ahead, past) | {"backward": 0}, past
    points, backward = table_points(db, *times, parameter)
    points = replace(points, parameter=parameter or points.parameter)
    return _document(Compensated(points), 0.0, limit, ahead) | {"backward": backward}, ()


def _print(document: dict[str, Any], form: str) -> None:
    if form == "json":
        print_json(document)
    elif form == "csv":
        rows = (
            {"t_ns": t, "time": iso_time(t), "value": value, "sd": sd} for t, value, sd in document["points"]
        )
        print_csv(("t_ns", "time", "value", "sd"), rows)
    else:
        show(_sentences(document))


def _document(
    found: Compensated, window: float, limit: float | None, ahead: Ahead, past: Sequence[Document] = ()
) -> dict[str, Any]:
    points = found.points
    history = history_of(points, window)
    steps = find_steps(history)
    asked = change(without(history, events(steps)))
    instants = points.t_ns.tolist()
    oldest, newest = (instants[0], instants[-1]) if instants else (0, 0)
    like = like_machines(ahead.like, points.parameter, limit)
    document: dict[str, Any] = {
        "rig": points.rig,
        "parameter": points.parameter,
        "unit": points.unit,
        "n": len(instants),
        "n_disjoint": len(disjoint(points.t_ns, np.maximum(points.span_s, window))),
        "refused": points.refused,
        "since": iso_time(oldest) if instants else None,
        "until": iso_time(newest) if instants else None,
        "span_s": (newest - oldest) / 1e9,
        **(_alone(points) if asked is None else _shape(asked, points)),
        "references": list(points.references),
        "clock_steps": points.clock_steps,
        "covariates": list(found.covariates),
        "without_covariates": found.unknown,
        "changes": [_step(step.t, step.size, step.sd, newest) for step in steps],
        "limit": limit,
        "forecast": forecast_document(history, newest, limit, horizon_days(ahead.horizon), like, past),
        "points": list(zip(instants, points.value.tolist(), points.sd.tolist(), strict=True)),
    }
    return document | {"words": verdict(document)}


def _alone(points: Points) -> dict[str, Any]:
    """Return what rows too few for a line say: the newest of them, and no slope."""
    newest = {"value": float(points.value[-1]), "sd": float(points.sd[-1])} if len(points.value) else {}
    return {**dict.fromkeys(_FIGURES), **newest, "trend": False}


_FIGURES = (
    "value", "sd", "slope_per_day", "slope_sd", "slope_lower", "slope_upper", "trend", "newest_slope_per_day",
    "newest_slope_sd", "curvature_per_day2", "curvature_sd",
)  # fmt: skip


def _shape(asked: Change, points: Points) -> dict[str, Any]:
    """Return level, slope and curvature.

    What the constants leave open is the same in every point: of the level, not of the slope.
    """
    curved = math.isfinite(asked.curvature_sd)
    curvature = (asked.curvature, asked.curvature_sd) if curved else (None, None)
    slopes = (asked.slope, asked.slope_sd, asked.slope_lower, asked.slope_upper)
    sd = math.hypot(asked.level_sd, common_sd(points))
    figures = (asked.level, sd, *slopes, asked.trend, asked.newest, asked.newest_sd, *curvature)
    return dict(zip(_FIGURES, figures, strict=True))


def _step(t: float, size: float, sd: float, newest_ns: int) -> dict[str, Any]:
    at = newest_ns + round(t * DAY_NS)
    return {"t_ns": at, "time": iso_time(at), "size": size, "sd": sd}


def _sentences(found: Document) -> str:
    name = f"{found['parameter']} of {found['rig']}"
    if not found["n"]:
        return f"{name}: no valid rows in that time"
    unit = unit_of(found)
    _, newest, sd = found["points"][-1]
    lines = [f"{name}: newest {with_sd(newest, sd)}{behind(unit)} at {short_time(found['until'])}"]
    lines.append(
        f"{counted(found['n'], 'row')} since {short_time(found['since'])}, "
        f"{found['n_disjoint']} of them share no samples"
    )
    if found["backward"]:
        stand = "row stands" if found["backward"] == 1 else "rows stand"
        lines.append(
            f"{found['backward']} {stand} before an earlier one, as after a step of a clock; put in order"
        )
    lines += _remarks(found)
    if found["slope_lower"] is None:
        lines.append("too few rows to tell a drift")
    else:
        there = f"{with_sd(found['value'], found['sd'])}{behind(unit)}"
        lines.append(f"line there: {there}; {drift(found)}: {finding(found)}")
    if found["limit"] is not None:
        lines.append(f"limit {number(found['limit'])}{behind(unit)}: {_distance(found, newest)}")
        lines += [forecast_words(found), *record_words(found["forecast"])]
    return "\n".join(lines)


def _remarks(found: Document) -> list[str]:
    """Say what in the history a reader might take for a change of the machine."""
    remarks = []
    if found["covariates"]:
        names = " and ".join(found["covariates"])
        remarks.append(f"what {names} does is taken out: values are those at what was learnt on average")
    if found["without_covariates"]:
        remarks.append(
            f"{found['without_covariates']} rows are less well known: a covariate is missing there"
        )
    if len(found["references"]) > 1:
        numbers = ", then ".join(number(reference) for reference in found["references"])
        remarks.append(
            f"rows of {len(found['references'])} references ({numbers}): their values are compared"
        )
    if found["clock_steps"] > 0:
        times = "once" if found["clock_steps"] == 1 else f"{found['clock_steps']} times"
        remarks.append(f"the wall clock was set otherwise {times}: instants follow it as it is set now")
    return remarks


def _distance(found: Document, newest: float) -> str:
    """Say how far the limit is, and whether it lies between the first row and the newest."""
    before, now = found["limit"] - found["points"][0][1], found["limit"] - newest
    beyond = before * now < 0
    words = f"{'crossed, ' if beyond else ''}{number(abs(now), 4)}{behind(unit_of(found))}"
    return f"{words} {'beyond it' if beyond else 'away'}"


def _print_all(db: Path, rig: str | None, times: tuple[str | None, str | None], form: str) -> None:
    """Print the trend of every parameter, one line each, those that change most in proportion first."""
    documents = []
    for name in [rig] if rig is not None else queries.rigs(db):
        for parameter in queries.parameters(db, name):
            found = compensated(db, points_of(db, name, parameter, *times))
            documents.append(_document(found, window_s(db, parameter), None, Ahead()))
    documents.sort(key=_share, reverse=True)
    if form == "json":
        print_json({"rows": [{k: v for k, v in found.items() if k != "points"} for found in documents]})
        return
    rows = [(d["rig"], d["parameter"], _newest(d), _sparkline(d), d["words"]) for d in documents]
    if form == "csv":
        print_csv(
            ("rig", "parameter", "words"), [{"rig": r[0], "parameter": r[1], "words": r[4]} for r in rows]
        )
    else:
        print_table("", ("rig", "parameter", "newest", "history", "trend"), rows)


def _share(found: Document) -> tuple[bool, float]:
    """Return the sort key of trends: whether there is one, and the share of the value changed in a day."""
    slope, value = found["slope_per_day"], found["value"]
    return bool(found["trend"]), abs(slope / value) if slope is not None and value else 0.0


def _newest(found: Document) -> str:
    if not found["n"]:
        return "no valid rows"
    _, value, sd = found["points"][-1]
    return f"{with_sd(value, sd)} {unit_of(found)}".rstrip()


def _sparkline(found: Document) -> str:
    """Return the history in sixteen bars, lowest to highest."""
    values = np.array([value for _, value, _ in found["points"]])
    if not len(values):
        return ""
    means = np.array([part.mean() for part in np.array_split(values, min(16, len(values)))])
    spread = float(np.ptp(means)) or 1.0
    return "".join(_BARS[int(level)] for level in np.rint((means - means.min()) / spread * (len(_BARS) - 1)))
