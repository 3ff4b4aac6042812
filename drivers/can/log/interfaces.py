"""Which interface's frames to read of a candump log: many tools log several into one file. Pure: no I/O."""

from collections.abc import Iterable

import numpy as np

from drivers.can.codec.frames import candump_row
from drivers.port import DriverConfigError


def wire_of(pieces: Iterable[bytes], wanted: str) -> bytes | None:
    """Return the interface whose frames are read; None for all: the log names at most one, whatever it is.

    Args:
        pieces: the log's text, whole lines each; read no further than needed.
        wanted: the interface that the source listens to.

    Raises DriverConfigError for a log of several interfaces, none of them the one that is wanted.
    """
    asked = wanted.encode()
    usual = b""
    found = set[bytes]()
    for text in pieces:
        usual = usual or _first(text)
        found |= _names(text, usual)
        if asked in found:
            return asked
    if len(found) < 2:
        return None
    names = ", ".join(sorted(name.decode("latin-1") for name in found))
    raise DriverConfigError(
        f"holds frames of {names} and none of {wanted}; name one of them as the source's channel"
    )


def _wire_in(line: bytes) -> bytes:
    """Return the interface that a line which is a frame names."""
    return line.split(None, 2)[1]


def _of_wire(text: bytes, name: bytes) -> bool:
    """Tell quickly whether all lines are frames of one interface; False where a line may be of another."""
    # a search for the name takes five times as long
    characters = np.frombuffer(text, np.uint8)
    close = np.flatnonzero(characters == ord(")"))
    if len(close) != text.count(b"\n") + (not text.endswith(b"\n")) or close[-1] + len(name) + 2 >= len(text):
        return False
    return all(
        bool((characters[close + place] == octet).all()) for place, octet in enumerate(b" " + name + b" ", 1)
    )


def _first(text: bytes) -> bytes:
    """Return the interface of the first line that is a frame; nothing where none is."""
    return next((_wire_in(line) for line in text.splitlines() if _is_frame(line)), b"")


def _names(text: bytes, usual: bytes) -> set[bytes]:
    """Return the interfaces that lines name; `usual` is known, and most lines are its."""
    if not usual or _of_wire(text, usual):
        return {usual} - {b""}
    mark = b") " + usual + b" "
    others = (line for line in text.split(b"\n") if mark not in line and _is_frame(line))
    return {usual, *(_wire_in(line) for line in others)}


def _is_frame(line: bytes) -> bool:
    return candump_row(line.decode("latin-1")) is not None
