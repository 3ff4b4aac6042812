"""`deltak compare`: methods side by side as a table, and their estimates over time as a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.terminal.output import print_table, show
from agent.cli.terminal.pictures import new_figure, save_picture
from agent.cli.tuning import LINE_POINTS
from agent.evaluation.compare.trial import Estimates
from agent.text import counted, number, with_sd

Document = Mapping[str, Any]


def print_compared(document: Document) -> None:
    """Print a row a method: newest estimates, what its predictions leave, its cost, what it was tuned to."""
    methods = document["methods"]
    names = list(next(iter(methods.values()))["estimates"]) if methods else []
    columns = ("method", *names, "prediction, sd", "% of motion", "µs a sample", "tuned to")
    rows = (
        (
            name, *(_estimate(row["estimates"][parameter]) for parameter in names),
            number(row["prediction_rms"], 3),
            number(row["prediction_percent"], 3), number(row["cost_us_per_sample"], 3), row["tuned"],
        )
        for name, row in methods.items()
    )  # fmt: skip
    title = f"{document['rig']}: {counted(document['samples'], 'sample')} of {document['recording']}"
    print_table(title, columns, rows, right=columns[1:-1])
    for name, why in document["skipped"].items():
        show(f"{name} does not apply: {why}")
    show(
        f"prediction: what {counted(document['windows'], 'window')} of {number(document['window_s'], 3)} s "
        "leave that each method had not seen, in standard deviations of the sensors' noise (1 is the noise "
        "itself) and of the motion"
    )


def _estimate(row: Document) -> str:
    if row["value"] is None:
        return "none valid"
    return with_sd(row["value"], row["sd"])


def draw(document: Document, rows: Mapping[str, Estimates], path: Path) -> None:
    """Draw each method's estimates over time. Raises UsageError without matplotlib or a place to write."""
    parameters = list(next(iter(document["methods"].values()))["estimates"].items()) if rows else []
    figure = new_figure(9, 1.2 + 2.0 * max(len(parameters), 1))
    axes = figure.subplots(max(len(parameters), 1), 1, sharex=True, squeeze=False)[:, 0]
    for column, (axis, (name, row)) in enumerate(zip(axes, parameters, strict=False)):
        _draw_parameter(axis, rows, column, document["samples"])
        axis.set_ylabel(f"{name}, {row['unit']}")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].legend(frameon=False, ncols=3)
    axes[-1].set_xlabel("sample")
    save_picture(figure, path)


def _draw_parameter(axis: Any, rows: Mapping[str, Estimates], column: int, samples: int) -> None:
    """Draw one parameter; the view is where the later half of estimates lies, a swinging start is cut off."""
    seen = []
    for name, found in rows.items():
        some = np.unique(np.linspace(0, len(found.index) - 1, min(len(found.index), LINE_POINTS)).astype(int))
        shown = np.where(found.valid[some, column], found.theta[some, column], np.nan)
        (line,) = axis.plot(found.index[some], shown, lw=0.9, label=name)
        if name == "window-ml":
            band = (
                np.where(np.isfinite(shown), edge[some, column], np.nan)
                for edge in (found.lower, found.upper)
            )
            axis.fill_between(found.index[some], *band, color=line.get_color(), alpha=0.2, lw=0)
        late = shown[(found.index[some] > samples // 2) & np.isfinite(shown)]
        seen.append(np.percentile(late, [2, 98]) if len(late) else np.array([]))
    edges = np.concatenate(seen)
    if len(edges):
        margin = 0.2 * (edges.max() - edges.min()) + 1e-9 * np.abs(edges).max()
        axis.set_ylim(edges.min() - margin, edges.max() + margin)
