"""`deltak check --plot`: poles over the region, where condition (3) holds, where today's estimate lies."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agent.blocks.rig_model import RigModel, rig_model
from agent.commissioning.regions.places import Plane, Today, newest, plane, poles_over
from agent.commissioning.tuning import LEAST_SIDE
from agent.config import load
from agent.errors import UsageError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INK, MODEL, OBSERVER, TODAY, HOLDS, FAILS = "#2b2b2b", "#1f77a4", "#d1603d", "#7a5ea8", "#e4f0e4", "#f6dcd5"


def draw_region(config: Path, document: dict[str, Any], file: Path, db: Path | None) -> None:
    """Draw a configuration that `deltak check` found usable to a file; db: where today's estimates stand.

    Raises UsageError for a picture that cannot be written, StoreError for a database that cannot be read.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError.at("--plot", "matplotlib is not installed", "pip install 'deltak[plot]'") from error
    figure = Figure(figsize=(12.0, 5.5), layout="constrained")
    if file.suffix.lstrip(".").lower() not in figure.canvas.get_supported_filetypes():
        raise UsageError.at(
            "--plot", f"{file}: no such format", "give a file that ends in .png, .svg or .pdf"
        )
    if not file.parent.is_dir():
        raise UsageError.at("--plot", f"{file.parent}: no such folder", "make it or name another")
    checked = load(config)
    rig = rig_model(checked)
    gain = np.array(document["observer"]["gain"], dtype=float)
    today = newest(checked, rig, db) if db is not None else None
    left, right = figure.subplots(1, 2)
    _draw_poles(left, *poles_over(checked, rig, gain))
    around = rig.model.nominal if today is None else today.theta
    _draw_plane(right, plane(checked, rig, gain, around), rig, today)
    worst = document["region"]["radius_model"]["value"] if document.get("region") else float("nan")
    title = f"{checked.rig.name}: within the alarm limits the model's spectral radius is at worst {worst:.6g}"
    figure.suptitle(title, x=0.01, ha="left", fontsize=11, color=INK)
    figure.savefig(file, dpi=150)


def _draw_poles(axis: "Axes", model: Any, observer: Any) -> None:
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 721))
    axis.plot(circle.real, circle.imag, color=INK, lw=0.8)
    for poles, colour, name in ((observer, OBSERVER, "observer"), (model, MODEL, "model")):
        axis.plot(
            poles[1:].real.ravel(), poles[1:].imag.ravel(), ".", ms=3, alpha=0.35, color=colour, label=name
        )
        axis.plot(poles[0].real, poles[0].imag, "x", ms=8, mew=1.8, color=colour, label=f"{name} at nominal")
    found = np.concatenate([model.ravel(), observer.ravel()])
    _frame(axis, found)
    axis.set_title("poles in discrete time; (3) asks for them within the circle", loc="left", fontsize=10)
    axis.legend(frameon=False, fontsize=8, loc="lower left")


def _frame(axis: "Axes", poles: Any) -> None:
    """Show all poles with some of the circle beside them."""
    for low, high, limit in (
        (poles.real.min(), max(1.0, poles.real.max()), axis.set_xlim),
        (poles.imag.min(), poles.imag.max(), axis.set_ylim),
    ):
        margin = 0.1 * max(high - low, LEAST_SIDE)
        limit(low - margin, high + margin)
    axis.grid(visible=True, color=INK, alpha=0.08, lw=0.6)


def _draw_plane(axis: "Axes", found: Plane | None, rig: RigModel, today: Today | None) -> None:
    if found is None:
        axis.text(0.5, 0.5, "fewer than two parameters may move", ha="center", transform=axis.transAxes)
        return
    levels = [-np.inf, 1.0, np.inf]
    axis.contourf(found.x, found.y, found.radius, levels=levels, colors=[HOLDS, FAILS], extend="neither")
    i, j = found.numbers
    nominal, half = rig.model.nominal, rig.limits
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    x, y = nominal[i] + corners[:, 0] * half[i], nominal[j] + corners[:, 1] * half[j]
    axis.plot(x, y, color=INK, lw=1.2, label="alarm limits")
    axis.plot(nominal[i], nominal[j], "x", color=INK, ms=8, mew=1.8, label="nominal")
    if today is not None:
        axis.errorbar(
            today.theta[i], today.theta[j], xerr=2 * np.nan_to_num(today.sd[i]),
            yerr=2 * np.nan_to_num(today.sd[j]),
            fmt="o", color=TODAY, ms=6, capsize=3, label=f"estimate of {today.time[:19]} ± 2 sd",
        )  # fmt: skip
    axis.set_xlabel(f"{rig.parameters[i].name}  ({rig.parameters[i].unit})")
    axis.set_ylabel(f"{rig.parameters[j].name}  ({rig.parameters[j].unit})")
    axis.set_title("(3) holds where it is green, fails where it is red", loc="left", fontsize=10)
    axis.legend(frameon=False, fontsize=8, loc="upper left")
