"""One line on a terminal that says how far long work is; nothing where nobody looks."""

import sys
from collections.abc import Callable

Progress = Callable[[str], None]
WIDTH = 60
"""Characters that words may take."""


def silent(_words: str) -> None:
    """Say nothing."""


def on_terminal() -> Progress:
    """Return what writes words over the words before; an empty text clears the line.

    It is silent without a terminal.
    """
    return _show if sys.stderr.isatty() else silent


def _show(words: str) -> None:
    """Overwrite by spaces: not every terminal knows a sequence that clears a line."""
    sys.stderr.write(f"\r{words:<{WIDTH}}" if words else f"\r{'':<{WIDTH}}\r")
    sys.stderr.flush()
