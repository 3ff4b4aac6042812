"""`deltak identify`: findings of a rig as sentences, and predicted against measured motion as a picture."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from agent.cli.terminal.output import print_table, show
from agent.cli.terminal.pictures import new_figure, save_picture
from agent.cli.tuning import DRAWN_SAMPLES
from agent.commissioning.explained import Explained
from agent.text import counted, interval, number, percent, with_sd

Document = Mapping[str, Any]


def print_identified(document: Document) -> None:
    """Print values with intervals, what cannot be known, what is unexplained, and what a file was given."""
    columns = ("parameter", "value", "unit", "95 %", "")
    rows = (
        (
            name,
            with_sd(row["value"], row["sd"]),
            row["unit"],
            interval(row["lower"], row["upper"]),
            row["why"] or "",
        )
        for name, row in document["parameters"].items()
    )
    title = (
        f"{document['rig']}: {counted(document['windows'], 'window')} of {number(document['window_s'], 3)} s"
    )
    print_table(title, columns, rows, right=columns[1:2])
    _print_graphs(document)
    shares = ", ".join(f"{name} {percent(share / 100)}" for name, share in document["unexplained"].items())
    show(f"share of the motion left unexplained: {shares}")
    show(f"{number(document['span_s'], 4)} s of recordings in {number(document['seconds'], 3)} s")
    for change in document["changes"] if document["ok"] else []:
        before = "nothing" if change["from"] is None else number(change["from"])
        show(f"{change['parameter']}: {before} -> {number(change['to'])}")
    if document["ok"]:
        written = document["written"]
        if written:
            show(f"written to {written}")
        elif not document.get("graph_changed"):
            show("nothing was written; --write puts these into the file")


def _print_graphs(document: Document) -> None:
    """Print the graphs that were weighed, the chosen one first, and what the file needs for it."""
    if not document["graph"]:
        return
    rows = (
        (", ".join(row["elements"]), number(row["score"], 4), _standing(row)) for row in document["graph"]
    )  # fmt: skip
    print_table(
        "graphs: score is a log likelihood, less what each element costs",
        ("elements", "score", ""),
        rows,
        right=("score",),
    )
    if document["graph_changed"]:
        show("the graph chosen is not the file's; under [model] it would be:")
        for line in document["toml"]:
            show(line)


def _standing(row: Document) -> str:
    words = [word for word in ("chosen", "tie", "configured") if row[word]]
    return ", ".join({"tie": "near tie", "configured": "the file's"}.get(word, word) for word in words)


def draw(document: Document, seen: Explained, path: Path) -> None:
    """Draw predicted against measured motion. Raises UsageError without matplotlib or a place to write."""
    names = list(document["unexplained"])
    figure = new_figure(9, 1.2 + 1.8 * len(names))
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    length = min(len(seen.measured), DRAWN_SAMPLES)
    t = np.arange(length)
    for column, (name, axis) in enumerate(zip(names, axes, strict=True)):
        share = percent(document["unexplained"][name] / 100)
        axis.set_title(f"{name}: {share} unexplained", loc="left")
        axis.plot(t, seen.measured[:length, column], color="tab:blue", lw=0.8, label="measured")
        axis.plot(t, seen.predicted[:length, column], color="tab:red", lw=0.8, ls="--", label="predicted")
        axis.spines[["top", "right"]].set_visible(False)
    axes[0].legend(frameon=False)
    axes[-1].set_xlabel("sample")
    save_picture(figure, path)
