"""`deltak watch`: the state of rigs in a terminal, read anew every second until q is pressed."""

import os
import select
import sys
import termios
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.cli.glance.files import Watched, one
from agent.cli.glance.frame import frame
from agent.cli.glance.state import overview
from agent.cli.terminal.output import console, show
from agent.cli.tuning import EVERY_S
from agent.clock import wall_ns
from agent.errors import StoreError
from agent.text import iso_time, printable, short_time

if TYPE_CHECKING:
    from rich.console import RenderableType


def watch(target: Path | None, *, once: bool) -> None:
    """Show the state of the rigs of a database or of a configuration's database; once: one frame and no more.

    Where stdout or stdin is no terminal it is one frame as well. The file is opened for each frame and only
    for reading, so nothing of it is held in between.

    Raises:
        StoreError: the first frame cannot be read; UsageError, ConfigError: the target.
    """
    watched = one(target)
    first = overview([watched], wall_ns())
    if once or not (sys.stdout.isatty() and sys.stdin.isatty()):
        show(frame(first, _clock()))
        return
    with _single_keys():
        _follow(watched)


def _follow(watched: Watched) -> None:
    """Draw a frame a second; n puts the next rig on top, for terminals that do not show all."""
    from rich.live import Live
    from rich.text import Text

    first = 0
    with Live(console=console(), screen=True, auto_refresh=False) as live:
        while True:
            picture: RenderableType
            try:
                picture = frame(
                    _turned(overview([watched], wall_ns()), first), f"{_clock()}   q quits, n: next rig"
                )
            except StoreError as error:
                picture = Text(printable(str(error)), style="red")
            live.update(picture, refresh=True)
            key = _pressed(EVERY_S).lower()
            if key in {"q", "\x04"}:
                return
            first += key == "n"


def _turned(found: dict[str, Any], first: int) -> dict[str, Any]:
    """Return an overview that begins with another rig than the worst."""
    rigs = found["rigs"]
    start = first % len(rigs) if rigs else 0
    return {**found, "rigs": rigs[start:] + rigs[:start]}


def _clock() -> str:
    return short_time(iso_time(wall_ns()))


def _pressed(seconds: float) -> str:
    """Return the key pressed within so many seconds; "" for none, end of input for a lost terminal."""
    terminal = sys.stdin.fileno()
    ready, _, _ = select.select([terminal], [], [], seconds)
    # not of sys.stdin, which would take what was typed behind it along, unseen by the next select
    return (os.read(terminal, 1).decode("ascii", "replace") or "\x04") if ready else ""


@contextmanager
def _single_keys() -> Iterator[None]:
    """Have keys come one by one and unseen; the terminal is as it was afterwards."""
    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal)
        yield
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
