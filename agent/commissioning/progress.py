"""One line on a terminal that says how far long work is; nothing where nobody looks."""

import sys
from collections.abc import Callable

from agent.commissioning.tuning import PROGRESS_WIDTH

Progress = Callable[[str], None]


def silent(_words: str) -> None:
    """Say nothing."""


def on_terminal() -> Progress:
    """Return what writes words over the words before; an empty text clears the line.

    It is silent without a terminal.
    """
    return _show if sys.stderr.isatty() else silent


def _show(words: str) -> None:
    """Overwrite by spaces: not every terminal knows a sequence that clears a line."""
    sys.stderr.write(f"\r{words:<{PROGRESS_WIDTH}}" if words else f"\r{'':<{PROGRESS_WIDTH}}\r")
    sys.stderr.flush()
