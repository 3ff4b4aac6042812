"""Which channel's frames to read of a log that numbers its channels: ASC, BLF, TRC and MF4. Pure: no I/O.

Channels are named here as the tools that write such logs show them. Python-can counts from 0 what ASC and BLF
files from 1. The `canN`, `vcanN` and `slcanN` of a source is the channel N + 1 of ASC, BLF and TRC logs,
where the loggers of python-can put it. MF4 logs have no such custom: python-can's begin with 0, those of
vehicle loggers with 1.
"""

import re
from collections.abc import Iterable

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
