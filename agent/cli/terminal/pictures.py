"""Pictures that commands draw to a file."""

from pathlib import Path
from typing import Any

from agent.errors import UsageError


def new_figure(width: float, height: float) -> Any:
    """Return an empty figure of matplotlib, in inches. Raises UsageError where that is not installed."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise UsageError.at("--plot", "matplotlib is not installed", "pip install 'deltak[plot]'") from error
    return Figure(figsize=(width, height), layout="constrained")


def save_picture(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib, in the form that the file's name ends with. Raises UsageError."""
    try:
        figure.savefig(path, dpi=130)
    except (OSError, ValueError) as error:
        advice = "name a .png, .svg or .pdf in a folder there is"
        raise UsageError.at("--plot", f"cannot write {path}: {error}", advice) from error
