"""The picture of a trend: history, line or curve, steps, limit and forecast."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.prognosis.words import time_unit
from agent.cli.terminal.pictures import new_figure, save_picture
from agent.cli.tuning import MOST_PAST
from agent.text import short_time

Document = Mapping[str, Any]


def draw(found: Document, path: Path, past: Sequence[Document] = ()) -> None:
    """Draw a trend, and past forecasts faintly. Raises UsageError without matplotlib or the file's place."""
    figure = new_figure(9, 3.6)
    axes = figure.add_subplot(ylabel=found["unit"] or "")
    axes.set_title(f"{found['parameter']} of {found['rig']}", loc="left")
    axes.spines[["top", "right"]].set_visible(False)
    if found["n"]:
        _draw_points(axes, found)
        _draw_past(axes, found, past)
        axes.legend(frameon=False)
    save_picture(figure, path)


def _draw_points(axes: Any, found: Document) -> None:
    """Draw every row with its 95 % interval; the line only where there is a trend."""
    t_ns, value, sd = zip(*found["points"], strict=True)
    seconds, word = time_unit(found["span_s"])
    t = (np.array(t_ns) - t_ns[-1]) / (seconds * 1e9)
    axes.set_xlabel(f"{word}s from {short_time(found['until'])}")
    axes.errorbar(
        t, value, yerr=1.96 * np.array(sd), fmt=".", ms=4, lw=0.8, color="tab:blue", label="estimate, 95 %"
    )
    if found["trend"]:
        axes.plot(
            t, found["value"] + found["slope_per_day"] * t * seconds / 86_400, color="tab:red", label="trend"
        )
    for change in found["changes"]:
        axes.axvline((change["t_ns"] - t_ns[-1]) / (seconds * 1e9), color="tab:gray", ls=":", label="step")
    if found["limit"] is not None:
        axes.axhline(found["limit"], color="black", ls="--", lw=1, label="limit")
    if found["forecast"] is not None and found["forecast"]["p50_s"] is not None:
        _draw_forecast(axes, found, value[-1], seconds)


def _draw_past(axes: Any, found: Document, past: Sequence[Document]) -> None:
    """Draw at most MOST_PAST forecasts of the past, from where they began to their medians at the limit."""
    seconds, _ = time_unit(found["span_s"])
    newest = found["points"][-1][0]
    shown = [row for row in past if row["p50_ns"] is not None]
    for number, row in enumerate(shown[:: max(1, -(-len(shown) // MOST_PAST))]):
        t = [(row[name] - newest) / (seconds * 1e9) for name in ("made_at_ns", "p50_ns")]
        label = None if number else "past forecasts"
        axes.plot(t, [row["level"], row["limit_value"]], color="tab:purple", alpha=0.2, lw=0.8, label=label)


def _draw_forecast(axes: Any, found: Document, newest: float, seconds: int) -> None:
    """Draw the fan from the newest row to the limit at P10, P50 and P90."""
    p10, p50, p90 = (found["forecast"][f"{name}_s"] / seconds for name in ("p10", "p50", "p90"))
    limit = found["limit"]
    axes.fill(
        [0.0, p10, p90], [newest, limit, limit], color="tab:orange", alpha=0.25, lw=0, label="forecast, 80 %"
    )
    axes.plot([0.0, p50], [newest, limit], color="tab:orange", lw=1)
