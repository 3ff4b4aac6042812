"""What the controller says about the bus itself: the kernel's error frames, by name. Pure: no I/O.

Classes and bits as in linux/can/error.h. An error frame is no sample: it is counted among the faults of the
line.
"""

from collections.abc import Callable

import numpy as np

from drivers.can.codec.frames import ERROR, FrameTable
from drivers.can.tuning import AGAIN_NS
from drivers.port import Counts, IntArray

BUS_OFF = "bus-off"
PASSIVE = "error-passive"
WARNING = "error-warning"
ACTIVE = "error-active"
RESTARTED = "restarted"
OVERFLOW = "controller overflow"
PLAIN = "error frame"
"""An error frame that does not say of what, as many logs hold them."""

_CLASSES = {
    0x001: "transmit time-out",
    0x002: "arbitration lost",
    0x008: "protocol error",
    0x010: "transceiver fault",
    0x020: "no acknowledgement",
    0x040: BUS_OFF,
    0x080: "bus error",
    0x100: RESTARTED,
}
_CONTROLLER = 0x004  # fixed by linux/can/error.h
_CONTROLLER_BITS = {0x03: OVERFLOW, 0x0C: WARNING, 0x30: PASSIVE, 0x40: ACTIVE}
_COUNTERS = 0x200  # fixed by linux/can/error.h
_STATES = {
    BUS_OFF: (
        "the controller has left the bus after too many errors of its own; it returns when it is restarted"
    ),
    PASSIVE: (
        "the controller sees so many errors that it may signal none: wrong bit rate, cable or termination"
    ),
    WARNING: "the controller sees many errors: look at bit rate, cable and termination",
    ACTIVE: "the controller is sound again",
    RESTARTED: "the controller was restarted after bus-off",
}


def names_of(identifier: int, controller: int) -> list[str]:
    """Return what an error frame of this identifier and this second data byte tells."""
    found = [name for bit, name in _CLASSES.items() if identifier & bit]
    if identifier & _CONTROLLER:
        found += [name for bits, name in _CONTROLLER_BITS.items() if controller & bits] or [
            "controller fault"
        ]
    return found or [PLAIN]


class ErrorWatch:
    """Counts error frames by name; reports each change of the controller's state and each new kind of fault.

    Args:
        bus: its name, for messages.
        counts: `faults` is told of every error frame.
        report: told of what an operator should know: (name, words). A state once, when it begins; any other
            fault when it has not been seen for a minute. Not told of error frames without a class, which are
            only counted.
    """

    def __init__(self, bus: str, counts: Counts, report: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._counts = counts
        self._report = report
        self._state = ACTIVE
        self._seen_ns: dict[str, int] = {}

    def restart(self) -> None:
        """Forget the state: the bus was opened anew."""
        self._state = ACTIVE

    def take(self, table: FrameTable, t_ns: IntArray) -> None:
        """Look at the error frames of a table (n,) with their times (n,)."""
        for number in np.flatnonzero(table["id"] & np.uint32(ERROR)).tolist():
            row = table[number]
            identifier = int(row["id"])
            data = row["data"]
            for name in names_of(identifier, int(data[1])):
                self._counts.faults[name] += 1
                self._describe(name, _counters(identifier, data.tolist()), int(t_ns[number]))

    def _describe(self, name: str, counters: str, t_ns: int) -> None:
        if name in _STATES:
            if name != self._state:
                self._report(name, f"{self._bus}: {name}: {_STATES[name]}{counters}")
            self._state = ACTIVE if name == RESTARTED else name
        elif name != PLAIN:
            if t_ns - self._seen_ns.get(name, -AGAIN_NS) >= AGAIN_NS:
                self._report(name, f"{self._bus}: {name}{counters}")
            self._seen_ns[name] = t_ns


def _counters(identifier: int, data: list[int]) -> str:
    if not identifier & _COUNTERS:
        return ""
    return f" (transmit errors {data[6]}, receive errors {data[7]})"
