"""Which frames of a log to read: an interface's (candump), a channel's (ASC, BLF, TRC, MF4). Pure: no I/O."""

import re
from collections.abc import Iterable

import numpy as np

from drivers.can.codec.frames import candump_row
from drivers.port import DriverConfigError

_FROM_1 = frozenset({".asc", ".blf", ".trc"})
_READ_FROM_0 = frozenset({".asc", ".blf"})
_KERNEL_NAME = re.compile(r"(?:v|sl)?can(\d+)")
_NAMES_OF_KERNEL = frozenset({"socketcan", "socketcand", "slcan", "virtual"})
"""Interfaces whose channels have names; others number them by themselves, from 0 or from 1."""


def shown(channel: object, kind: str) -> str:
    """Return the name of a channel, as python-can reads it from a log of that suffix."""
    if channel is None:
        return "without a number"
    return str(channel + 1) if isinstance(channel, int) and kind in _READ_FROM_0 else str(channel)


def channel_of(found: Iterable[str], wanted: str, interface: str, kind: str) -> str | None:
    """Return the channel of a log whose frames are read; None where all are: the log has one, whatever it is.

    Args:
        found: the channel of each of its frames; read no further than needed.
        wanted: the channel that the source listens to.
        interface: what it listens by.
        kind: the log's suffix.

    Raises DriverConfigError for a log of several channels, none of them surely the one that is wanted.
    """
    number = _KERNEL_NAME.fullmatch(wanted)
    is_name = interface in _NAMES_OF_KERNEL or not wanted.isdigit()
    sought = wanted if is_name else None
    begins_with_0 = None
    if number and kind in _FROM_1:
        sought = str(int(number[1]) + 1)
    elif number:
        begins_with_0 = number[1]
    there: dict[str, None] = {}
    for name in found:
        if name == sought:
            return name
        there[name] = None
    if {begins_with_0, "0"} <= there.keys():
        return begins_with_0
    if len(there) < 2:
        return None
    names = ", ".join(sorted(there, key=lambda name: (len(name), name)))
    raise DriverConfigError(f"holds frames of channels {names} and none of {wanted}; {_advice(is_name)}")


def _advice(is_name: bool) -> str:
    words = 'name one of them as the source\'s channel, e.g. channel = "1"'
    return (
        words
        if is_name
        else f'{words}, with interface = "socketcan": other interfaces number theirs otherwise'
    )


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
