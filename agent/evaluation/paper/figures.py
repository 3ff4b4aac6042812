"""Figures 3 and 4 of the paper as one picture."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.errors import Fault, UsageError
from agent.evaluation.paper import cases
from agent.evaluation.paper.methods import product_rows, seed_settings, valid_changes
from agent.evaluation.tuning import DRAWN_HOP
from agent.numerics.model.statespace import discretise
from agent.numerics.paper.seed import Stopping, observe
from agent.numerics.paper.seed_window import fit_passes
from agent.types import FloatArray, IntArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PATIENCE = Stopping(iterations=300)
"""Descent in windows that hold a change need not converge; 20 iterations do in the others."""
INK, ACTUAL, PRINTED, RECENTRED, PRODUCT = "#2b2b2b", "#b5b5b5", "#d1603d", "#7a5ea8", "#1f77a4"


def new_figure(file: Path) -> "Figure":
    """Return an empty figure for a file.

    Raises UsageError where matplotlib is missing, does not know the file's format, or its folder is not
    there.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError(
            [Fault("--plot", "matplotlib is not installed", "pip install 'deltak[plot]'")]
        ) from error
    figure = Figure(figsize=(13.0, 8.0), layout="constrained")
    if file.suffix.lstrip(".").lower() not in figure.canvas.get_supported_filetypes():
        raise UsageError(
            [Fault("--plot", f"{file}: no such format", "give a file that ends in .png, .svg or .pdf")]
        )
    if not file.parent.is_dir():
        raise UsageError([Fault("--plot", f"{file.parent}: no such folder", "make it or name another")])
    return figure


def draw(figure: "Figure", document: dict[str, Any], file: Path) -> None:
    """Draw observer against measurement (figure 3) and sliding estimates of case 2 (figure 4) to a file."""
    window, case = document["window"], document["case_1"]
    grid = figure.add_gridspec(4, 2, width_ratios=(1.0, 1.75))
    _figure_3([figure.add_subplot(grid[:2, 0]), figure.add_subplot(grid[2:, 0])])
    _figure_4([figure.add_subplot(grid[row, 1]) for row in range(4)], window, case["passes"])
    times = case["condition_8"]["perturbation_norm"] / case["condition_8"]["delta"]
    title = f"Two masses, two springs, two dampers; case 1 is {times:.0f} times what condition (8) bears"
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)
    figure.savefig(file, dpi=150)


def _figure_3(axes: "list[Axes]") -> None:
    y = cases.free_decay((cases.CASE_2[0].actual,), "euler")
    model = discretise(cases.rig().continuous(cases.NOMINAL), cases.PERIOD_S, "euler").model
    observed = observe(model, cases.GAIN, y, np.zeros((len(y), 1)), np.zeros(4))[:-1] @ model.C.T
    samples = np.arange(1, len(y) + 1)
    for i, axis in enumerate(axes):
        axis.plot(samples, 1e3 * y[:, i], color=ACTUAL, lw=4, label="measured")
        axis.plot(samples, 1e3 * observed[:, i], color=PRINTED, lw=1.2, label="observer")
        axis.set_ylabel(f"x{i + 1}  (mm)")
        _tidy(axis)
    axes[0].set_title("Figure 3: the observer's outputs, case 1", loc="left", fontsize=10, color=INK)
    axes[0].legend(frameon=False, fontsize=9)
    axes[-1].set_xlabel("sample")


def _figure_4(axes: "list[Axes]", window: int, passes: int) -> None:
    changes = tuple(combination.actual for combination in cases.CASE_2)
    curves = [
        ("as printed", PRINTED, *_seed_curve(changes, window, 1)),
        (f"re-centred, {passes} passes", RECENTRED, *_seed_curve(changes, window, passes)),
        ("window-ml", PRODUCT, *_product_curve(changes, window)),
    ]
    for i, axis in enumerate(axes):
        actual = np.repeat([change[i] for change in changes], cases.SEGMENT)
        axis.plot(
            np.arange(1, len(actual) + 1), actual, color=ACTUAL, lw=5, solid_capstyle="butt", label="actual"
        )
        last = np.searchsorted(curves[0][2], np.arange(1, len(changes) + 1) * cases.SEGMENT)
        _limit(axis, np.concatenate([actual, curves[0][3][last, i]]))
        for name, colour, index, values in curves:
            shown = _clean(index, values[:, i], window)
            axis.plot(index, shown, color=colour, lw=1.5, label=name)
            if colour == PRINTED:
                _name_settled(axis, index[last], shown[last], actual[index[last] - 1])
        for start in range(cases.SEGMENT, len(actual), cases.SEGMENT):
            axis.axvspan(start, start + window, color=INK, alpha=0.06, lw=0)
        axis.set_ylabel(f"Δ{cases.PARAMETERS[i]}  ({cases.UNITS[i]})")
    axes[0].set_title(
        f"Figure 4: case 2, window of {window} samples (grey: it holds a change, and no line is drawn)",
        loc="left", fontsize=10, color=INK,
    )  # fmt: skip
    axes[0].figure.legend(
        *axes[0].get_legend_handles_labels(), loc="upper right", ncols=4, frameon=False, fontsize=9
    )
    axes[-1].set_xlabel("sample")


def _limit(axis: "Axes", settled: FloatArray) -> None:
    """Show settled values with room about them."""
    low, high = float(settled.min()), float(settled.max())
    margin = 0.35 * max(high - low, 1e-9)
    axis.set_ylim(low - margin, high + margin)
    _tidy(axis)


def _clean(index: IntArray, values: FloatArray, window: int) -> FloatArray:
    """Return values with NaN for windows that hold a change: one gap a change, and no line in pieces."""
    return np.where((index > cases.SEGMENT) & ((index - 1) % cases.SEGMENT + 1 < window), np.nan, values)


def _name_settled(axis: "Axes", samples: IntArray, values: FloatArray, actual: FloatArray) -> None:
    """Write the value of each segment's last sample on the side of it that is away from the actual one."""
    for sample, value, true in zip(samples.tolist(), values.tolist(), actual.tolist(), strict=True):
        below = value < true
        axis.annotate(
            f"{value:.3g}".replace("-", "−"), (sample, value), (-4, -4 if below else 3),
            textcoords="offset points",
            ha="right", va="top" if below else "bottom", fontsize=8, color=PRINTED,
        )  # fmt: skip


def _tidy(axis: "Axes") -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(visible=True, color=INK, alpha=0.08, lw=0.6)
    axis.margins(x=0.01)


def _seed_curve(changes: tuple[FloatArray, ...], window: int, passes: int) -> tuple[IntArray, FloatArray]:
    """Return sample numbers and changes; passes run the observer from the first sample, as in the tables."""
    y = cases.free_decay(changes, "euler")
    u = np.zeros((len(y), 1))
    settings = replace(seed_settings(window, passes), stopping=PATIENCE)
    index = np.arange(window + DRAWN_HOP, len(y) + 1, DRAWN_HOP)
    theta = [fit_passes(cases.rig(), settings, y[:stop], u[:stop]).theta for stop in index.tolist()]
    return index, np.array(theta) - cases.NOMINAL


def _product_curve(changes: tuple[FloatArray, ...], window: int) -> tuple[IntArray, FloatArray]:
    rows = product_rows(cases.free_decay(changes, "zero"), window, DRAWN_HOP)
    return rows.index + 1, valid_changes(rows)
