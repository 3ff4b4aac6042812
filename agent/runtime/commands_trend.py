"""`deltak trend`: a parameter's drift, as sentences, JSON, CSV or a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.errors import UsageError
from agent.numerics.trend import DAY_NS, Trend, fit_trend
from agent.runtime.cli_output import print_csv, print_json, show
from agent.storage import queries
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
    found = fit_trend(points.t_ns, points.value, points.sd, np.maximum(points.span_s, window_s))
    instants = points.t_ns.tolist()
    return {
        "rig": points.rig,
        "parameter": points.parameter,
        "unit": points.unit,
        "n": len(instants),
        "n_disjoint": found.n_disjoint,
        "since": iso_time(instants[0]) if instants else None,
        "until": iso_time(instants[-1]) if instants else None,
        **{key: getattr(found, key) for key in Trend.__dataclass_fields__ if key != "n_disjoint"},
        "limit": limit,
        "forecast": None,
        "points": list(zip(instants, points.value.tolist(), points.sd.tolist(), strict=True)),
    }


def _sentences(found: Document) -> str:
    name = f"{found['parameter']} of {found['rig']}"
    if not found["n"]:
        return f"{name}: no valid rows in that time"
    unit = found["unit"] or ""
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
        lines.append(f"limit {number(found['limit'])} {unit}: {number(found['limit'] - newest, 4)} {unit} away")
    return "\n".join(lines)


def _drift(found: Document) -> str:
    """Write the drift in a unit of time that suits the span."""
    span_s = (found["points"][-1][0] - found["points"][0][0]) / 1e9
    seconds, word = (1, "second") if span_s < 600 else (3600, "hour") if span_s < 172_800 else (86_400, "day")
    slope, sd, lower, upper = (found[f"slope_{k}"] * seconds / 86_400 for k in ("per_day", "sd", "lower", "upper"))
    return f"drift {with_sd(slope, sd)} {found['unit'] or ''} per {word} (95 %: {interval(lower, upper)})"


def _draw(found: Document, path: Path) -> None:
    """Draw points, line and limit. Raises UsageError where matplotlib or the place for the file is missing."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError.at("--plot", "matplotlib is not installed", "pip install 'deltak[plot]'") from error
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.add_subplot(
        xlabel="days before the newest row", ylabel=f"{found['parameter']}, {found['unit'] or ''}"
    )
    axes.set_title(f"{found['parameter']} of {found['rig']}", loc="left")
    if found["n"]:
        _draw_points(axes, found)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise UsageError.at(
            "--plot", f"cannot write {path}: {error}", "name a .png, .svg or .pdf in a folder there is"
        ) from error


def _draw_points(axes: Any, found: Document) -> None:
    _, value, sd = np.array(found["points"], dtype=np.float64).T
    days = np.array([point[0] - found["points"][-1][0] for point in found["points"]]) / DAY_NS
    axes.errorbar(days, value, yerr=2 * sd, fmt=".", ms=3, lw=0.6, color="tab:blue", alpha=0.6, label="estimate ± 2 sd")
    if found["slope_per_day"] is not None:
        axes.plot(days, found["value"] + found["slope_per_day"] * days, color="tab:red", label="trend line")
    if found["limit"] is not None:
        axes.axhline(found["limit"], color="black", ls="--", lw=1, label="limit")
    axes.legend(frameon=False)
