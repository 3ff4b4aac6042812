"""`deltak trend`: a parameter's drift, as sentences, JSON, CSV or a picture."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.output import print_csv, print_json, show
from agent.errors import UsageError
from agent.numerics.trend import DAY_NS, Trend, fit_trend
from agent.storage.read import queries
from agent.text import interval, iso_time, number, short_time, with_sd

Document = Mapping[str, Any]


def trend(
    db: Path,
    parameter: str,
    rig: str | None,
    times: tuple[str | None, str | None],
    limit: float | None,
    form: str,
    plot: Path | None,
) -> None:
    """Print a parameter's trend. Raises StoreError; UsageError for a parameter, rig, time or picture that cannot be."""
    if limit is not None and not math.isfinite(limit):
        raise UsageError.at("--limit", f"must be a number, not {limit:g}", "give a value of the parameter, in its unit")
    document = _document(queries.points(db, rig, parameter, *times), _window_s(db, parameter), limit)
    if plot is not None:
        _draw(document, plot)
    if form == "json":
        print_json(document)
    elif form == "csv":
        rows = ({"t_ns": t, "time": iso_time(t), "value": value, "sd": sd} for t, value, sd in document["points"])
        print_csv(("t_ns", "time", "value", "sd"), rows)
    else:
        show(_sentences(document))


def _window_s(db: Path, parameter: str) -> float:
    """Return the longest window that newest estimates of a parameter rest on."""
    rows = queries.latest(db)
    return max((row["window_s"] or 0.0 for row in rows if row["parameter"] == parameter), default=0.0)


def _document(points: queries.Points, window_s: float, limit: float | None) -> dict[str, Any]:
    found = fit_trend(points.t_ns, points.value, points.sd_repeat, np.maximum(points.span_s, window_s))
    if found.sd is not None:  # what the constants leave open is the same in every point: of the level, not the slope
        found = replace(found, sd=math.hypot(found.sd, _common(points)))
    instants = points.t_ns.tolist()
    return {
        "rig": points.rig,
        "parameter": points.parameter,
        "unit": points.unit,
        "n": len(instants),
        "n_disjoint": found.n_disjoint,
        "refused": points.refused,
        "since": iso_time(instants[0]) if instants else None,
        "until": iso_time(instants[-1]) if instants else None,
        **{key: getattr(found, key) for key in Trend.__dataclass_fields__ if key != "n_disjoint"},
        "limit": limit,
        "forecast": None,
        "points": list(zip(instants, points.value.tolist(), points.sd.tolist(), strict=True)),
    }


def _common(points: queries.Points) -> float:
    """Return the sd of what the newest point shares with all the others."""
    return math.sqrt(max(float(points.sd[-1]) ** 2 - float(points.sd_repeat[-1]) ** 2, 0.0))


def _sentences(found: Document) -> str:
    name = f"{found['parameter']} of {found['rig']}"
    if not found["n"]:
        return f"{name}: no valid rows in that time"
    unit = _unit(found)
    _, newest, sd = found["points"][-1]
    lines = [f"{name}: newest {with_sd(newest, sd)} {unit} at {short_time(found['until'])}"]
    lines.append(
        f"{found['n']} rows since {short_time(found['since'])}, {found['n_disjoint']} of them share no samples"
    )
    if found["slope_lower"] is None:
        lines.append("too few rows to tell a drift")
    else:
        verdict = "a trend" if found["trend"] else "no trend: the interval holds 0"
        lines.append(f"line there: {with_sd(found['value'], found['sd'])} {unit}; {_drift(found)}: {verdict}")
    if found["limit"] is not None:
        lines.append(f"limit {number(found['limit'])} {unit}: {_distance(found, newest)}".replace("  ", " "))
    return "\n".join(lines)


def _distance(found: Document, newest: float) -> str:
    """Say how far the limit is, and whether it lies between the first row and the newest."""
    before, now = found["limit"] - found["points"][0][1], found["limit"] - newest
    beyond = before * now < 0
    return f"{'crossed, ' if beyond else ''}{number(abs(now), 4)} {_unit(found)} {'beyond it' if beyond else 'away'}"


def _unit(found: Document) -> str:
    """Return the unit as it is written behind a number; nothing for a bare number."""
    return "" if found["unit"] in {None, "1"} else str(found["unit"])


def _drift(found: Document) -> str:
    """Write the drift in a unit of time that suits the span."""
    seconds, word = _time_unit(found)
    slope, sd, lower, upper = (found[f"slope_{k}"] * seconds / 86_400 for k in ("per_day", "sd", "lower", "upper"))
    change = f"{with_sd(slope, sd)} {_unit(found)}".rstrip()
    return f"drift {change} per {word} (95 %: {interval(lower, upper)})"


def _time_unit(found: Document) -> tuple[int, str]:
    """Return seconds and name of the unit of time in which people read the span of the rows."""
    span_s = (found["points"][-1][0] - found["points"][0][0]) / 1e9
    return (1, "second") if span_s < 600 else (3600, "hour") if span_s < 172_800 else (86_400, "day")


def _draw(found: Document, path: Path) -> None:
    """Draw points, line and limit. Raises UsageError where matplotlib or the place for the file is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError.at("--plot", "matplotlib is not installed", "pip install 'deltak[plot]'") from error
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    axes = figure.add_subplot(ylabel=found["unit"] or "")
    axes.set_title(f"{found['parameter']} of {found['rig']}", loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    if found["n"]:
        _draw_points(axes, found)
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        advice = "name a .png, .svg or .pdf in a folder there is"
        raise UsageError.at("--plot", f"cannot write {path}: {error}", advice) from error


def _draw_points(axes: Any, found: Document) -> None:
    """Draw every row with its 95 % interval; the line only where there is a trend."""
    t_ns, value, sd = zip(*found["points"], strict=True)
    seconds, word = _time_unit(found)
    t = (np.array(t_ns) - t_ns[-1]) / (seconds * 1e9)
    axes.set_xlabel(f"{word}s before {short_time(found['until'])}")
    axes.errorbar(t, value, yerr=1.96 * np.array(sd), fmt=".", ms=4, lw=0.8, color="tab:blue", label="estimate, 95 %")
    if found["trend"]:
        line = found["value"] + found["slope_per_day"] * t * seconds * 1e9 / DAY_NS
        axes.plot(t, line, color="tab:red", label="trend")
    if found["limit"] is not None:
        axes.axhline(found["limit"], color="black", ls="--", lw=1, label="limit")
    axes.legend(frameon=False)
