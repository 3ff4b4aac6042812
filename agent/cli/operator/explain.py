"""`deltak explain`: the words, the table of what was tested, and the picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.terminal.output import print_table, show
from agent.cli.terminal.pictures import new_figure, save_picture
from agent.errors import UsageError
from agent.evaluation.explain.explain import Explained
from agent.evaluation.explain.explain import explain as explained
from agent.storage.read.times import parse_time
from agent.text import number


def explain(db: Path, alarm: int, plot: Path | None) -> dict[str, Any]:
    """Return the document of an explanation, and draw it where asked for. Raises StoreError, UsageError."""
    found = explained(db, alarm)
    if plot is not None:
        draw(found, plot)
    return found.document


def print_explained(document: Mapping[str, Any]) -> None:
    """Print an explanation."""
    show(document["words"])
    if document.get("tested"):
        columns = ("tested", "size", "sd", "unit", "limit", "probability", "status")
        rows = (
            (one["hypothesis"], number(one["size"]), number(one["sd"], 2), one["unit"], number(one["limit"]),
             number(one["probability"], 3), one["status"] or "")
            for one in document["tested"]
        )  # fmt: skip
        print_table("", columns, rows, right=("size", "sd", "limit", "probability"))


def draw(found: Explained, path: Path) -> None:
    """Draw samples and estimate around an alarm. Raises UsageError: no matplotlib, no samples, no place."""
    figure = new_figure(9, 6)
    if found.kept is None or found.again is None:
        raise UsageError.at("--plot", "there is nothing to draw", found.document["words"])
    upper, lower = figure.subplots(2, 1, sharex=True)
    zero = parse_time(found.alarm["raised_at"], None)
    _draw_samples(upper, found, zero)
    _draw_estimate(lower, found, zero)
    upper.set_title(found.alarm["message"], loc="left")
    for axes in (upper, lower):
        axes.axvline(0.0, color="black", lw=0.8)
        axes.spines[["top", "right"]].set_visible(False)
    lower.set_xlabel("seconds from the alarm")
    save_picture(figure, path)


def _draw_samples(axes: Any, found: Explained, zero: int) -> None:
    """Draw each channel in units of its own spread."""
    assert found.kept is not None  # noqa: S101 - draw looked
    t = (found.kept.t_ns - zero) / 1e9
    for place, name in enumerate(found.kept.channels):
        values = found.kept.values[:, place]
        spread = float(np.nanstd(values)) or 1.0
        axes.plot(t, (values - np.nanmean(values)) / spread + 6.0 * place, lw=0.6, label=name)
    axes.set_yticks([])
    if found.kept.channels:  # of several sources the record has them by source
        axes.legend(frameon=False, loc="upper left")


def _draw_estimate(axes: Any, found: Explained, zero: int) -> None:
    """Draw the change of the alarm's parameter with its 95 % interval, and the limit."""
    assert found.again is not None  # noqa: S101 - draw looked
    name, limit = found.alarm["parameter"], found.alarm["limit_value"]
    for batch in found.again.batches:
        if name in batch.parameters:
            column = batch.parameters.index(name)
            delta = batch.value[:, column] - batch.reference[column]
            t = (batch.t_ns - zero) / 1e9
            axes.errorbar(t, delta, yerr=1.96 * batch.sd[:, column], fmt=".", ms=4, lw=0.8, color="tab:blue")
    for side in (-1.0, 1.0) if limit is not None else ():
        axes.axhline(side * limit, color="tab:red", ls="--", lw=1)
    axes.set_ylabel(f"change of {name}")
