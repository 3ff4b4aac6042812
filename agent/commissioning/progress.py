"""One line on a terminal that says how far long work is; nothing where nobody looks."""

import sys
from collections.abc import Callable

Progress = Callable[[str], None]


def silent(_words: str) -> None:
    """Say nothing."""


def on_terminal() -> Progress:
    """Return what writes words over the words before; an empty text clears the line.

    It is silent without a terminal.
    """
    return _show if sys.stderr.isatty() else silent


def _show(words: str) -> None:
    sys.stderr.write(f"\r\x1b[K{words}")
    sys.stderr.flush()
