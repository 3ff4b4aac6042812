"""Every fault a device or line can have, by name: how long it lasts, what it is, what a reader makes of it.

`cause` is what a reader that counts everything can say of it ("" where there is nothing to be seen from its
side).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from drivers.modbus.frames import EXCEPTIONS as KNOWN_EXCEPTIONS
from drivers.modbus.frames import UNKNOWN_EXCEPTION
from sim_bus.tuning import FAULT_S

ONE_SAMPLE = 0.0  # fixed by its meaning: no time, s


@dataclass(frozen=True, slots=True)
class FaultKind:
    """One fault.

    Attributes:
        words: what happens.
        cause: what its reader can say of it.
        lasts_s: for how long where nothing is said; 0 is one sample.
        loses: the samples that it strikes never arrive whole.
        timed: it lasts by the clock, whatever samples there are.
    """

    words: str
    cause: str
    lasts_s: float = ONE_SAMPLE
    loses: bool = False
    timed: bool = False


NUMBERS: Mapping[str, FaultKind] = {
    "nan": FaultKind("the first mapped field that is a float holds no number", "missing value", loses=True),
    "inf": FaultKind("the first mapped field that is a float is infinite", "not finite", loses=True),
    "range": FaultKind("the last mapped field is at the end of its range, or a million", "spike"),
    "swapped": FaultKind("the bytes of the last mapped field are in the wrong order", "spike"),
}
"""What any device can put into its numbers."""

COUNTERS: Mapping[str, FaultKind] = {
    "stuck-counter": FaultKind("the counter stands still while samples come", "duplicate", 0.02, loses=True),
    "counter-reset": FaultKind("the counter begins at 0 again, without a pause", "restart"),
    "counter-jump": FaultKind("the counter leaps ahead by 1000, and stays there", "gap"),
    "restart": FaultKind("silence, then the counter begins at 0 again", "restart", FAULT_S, loses=True),
}
"""What a device that sends its own counter can do with it."""

LINES: Mapping[str, FaultKind] = {
    "drop": FaultKind("the sample is not sent", "gap", loses=True),
    "loss": FaultKind("one sample in five is not sent", "gap", 1.0),
    "duplicate": FaultKind("the sample is sent twice", "duplicate"),
    "reorder": FaultKind("the sample changes places with the next one", "backwards", loses=True),
    "shuffle": FaultKind("the samples come in any order within 50", "backwards", 0.1),
    "corrupt": FaultKind("one bit of the sample is wrong", "crc", loses=True),
    "truncate": FaultKind("the second half of the sample is missing", "stray bytes", loses=True),
    "garbage": FaultKind("rubbish comes before the sample", "sync"),
    "freeze": FaultKind("nothing is sent", "gap", FAULT_S, loses=True),
    "silence": FaultKind("nothing is sent for longer than a source may be silent", "stale", 3.0, loses=True),
    "stall": FaultKind("everything is sent, but only at the end", "", FAULT_S),
    "jitter": FaultKind("samples are sent late, several at once", "", FAULT_S),
    "split": FaultKind("the second half of each sample comes with the next one", "", FAULT_S),
    "disconnect": FaultKind("the line is gone", "lost", FAULT_S, timed=True),
}
"""What any line can do to what a device sends by itself."""

BYTES: Mapping[str, FaultKind] = {
    "delete": FaultKind("one byte of the sample is missing", "crc", loses=True),
    "insert": FaultKind("one byte too many lies in the sample", "crc", loses=True),
    "break": FaultKind("32 zeros come before the sample", "sync"),
    "baud": FaultKind("every byte is another one, as at a wrong bit rate", "sync", FAULT_S, loses=True),
    "stolen": FaultKind(
        "another program takes a part of each sample from the line", "crc", FAULT_S, loses=True
    ),
}
"""What a serial line can do besides."""

FRAMES: Mapping[str, FaultKind] = {
    "dlc": FaultKind("the frame has a byte too few", "dlc", loses=True),
    "foreign": FaultKind("a frame comes that nobody asked for", ""),
    "flood": FaultKind("a hundred frames that nobody asked for come with each sample", "", 0.05),
    "extended": FaultKind("a frame comes whose long identifier is the sample's number", ""),
    "remote": FaultKind("a frame comes that asks for the sample instead of carrying it", "remote frame"),
    "checksum": FaultKind("one bit of the frame's data is wrong; its checksum tells", "checksum", loses=True),
    "error-frame": FaultKind("the controller reports a bus error", "bus error"),
    "error-warning": FaultKind("the controller sees many errors (adapters)", "error-warning", FAULT_S),
    "error-passive": FaultKind(
        "the controller may signal errors no more (adapters)", "error-passive", FAULT_S
    ),
    "overrun": FaultKind(
        "the controller had no room for the sample (adapters)", "controller overflow", loses=True
    ),
    "bus-off": FaultKind("the controller is off the bus, and comes back", "bus-off", FAULT_S, loses=True),
}
"""What a CAN bus can do besides."""

_ON_TEXT = {
    name: replace(LINES[name], cause=cause)
    for name, cause in (("corrupt", "text"), ("garbage", "text"), ("truncate", "gap"))
}
"""What a broken message of a CAN daemon looks like."""

EXCEPTIONS: Mapping[int, str] = {**KNOWN_EXCEPTIONS, 85: UNKNOWN_EXCEPTION}
REPLIES: Mapping[str, FaultKind] = {
    **{
        f"exception-{code}": FaultKind(f"every answer is {named}", named, FAULT_S, timed=True)
        for code, named in ((code, f"exception {code} ({words})") for code, words in EXCEPTIONS.items())
    },
    "busy": FaultKind("every answer is exception 6", "exception 6 (device busy)", FAULT_S, timed=True),
    "hang": FaultKind("the registers do not move", "", FAULT_S, timed=True),
    "silent": FaultKind("no answer comes", "timeout", FAULT_S, timed=True),
    "late": FaultKind("answers come after they were given up", "timeout", FAULT_S, timed=True),
    "slow": FaultKind("answers take half of the time that they may take", "", FAULT_S, timed=True),
    "dribble": FaultKind("answers come byte by byte", "", FAULT_S, timed=True),
    "disconnect": FaultKind("the server is gone", "lost", FAULT_S, timed=True),
    "reset": FaultKind("the connection is reset in the middle of each answer", "lost", 0.05, timed=True),
    "hang-up": FaultKind("the connection is closed after each answer", "", FAULT_S, timed=True),
    "accept-close": FaultKind("connections are accepted and closed", "lost", FAULT_S, timed=True),
    "black-hole": FaultKind("neither answers come nor new connections about", "timeout", FAULT_S, timed=True),
    "half-open": FaultKind("the connection is dead and nobody says so", "timeout", 0.05, timed=True),
    "wrong-unit": FaultKind("answers carry another unit's number", "unit", 0.05, timed=True),
    "wrong-transaction": FaultKind(
        "answers carry another transaction number", "transaction", 0.05, timed=True
    ),
    "wrong-protocol": FaultKind(
        "answers carry a protocol number that is not Modbus", "reply", 0.05, timed=True
    ),
    "wrong-function": FaultKind("answers are of another function", "reply", 0.05, timed=True),
    "wrong-count": FaultKind("answers say another number of bytes than they have", "reply", 0.05, timed=True),
    "short": FaultKind("answers have a register too few", "reply", 0.05, timed=True),
    "long": FaultKind("answers have a register too many", "reply", 0.05, timed=True),
    "corrupt": FaultKind("one bit of each answer is wrong (serial lines)", "timeout", 0.05, timed=True),
    "truncate": FaultKind("the second half of each answer is missing", "timeout", 0.05, timed=True),
    "garbage": FaultKind("rubbish comes before each answer", "reply", 0.05, timed=True),
    "duplicate": FaultKind("each answer comes twice", "reply", 0.05, timed=True),
    "restart": FaultKind(
        "no answer, then an empty ring and an index from 0 on", "timeout", FAULT_S, timed=True
    ),
}
"""What a Modbus device or its line can do."""

SENSORS: Mapping[str, FaultKind] = {
    "stuck": FaultKind("the reading stands still", "", 2.0),
    "dead": FaultKind("the reading is zero", "", 2.0),
    "reversed": FaultKind("the reading has the wrong sign", "", 2.0),
    "scaled": FaultKind("the reading is a thousand times too large", "", 2.0),
    "gain": FaultKind("the reading is a fifth too small", "", 2.0),
    "offset": FaultKind("the reading is too high, by half of the largest so far", "", 2.0),
    "drift": FaultKind("the reading runs away, by half of the largest so far each second", "", 2.0),
    "saturated": FaultKind("the reading ends at half of the largest so far", "", 2.0),
    "flicker": FaultKind("the reading stands still but for its last digit", "", 2.0),
    "spikes": FaultKind("ten readings a second are off by twice the largest so far", "spike", 2.0),
}
"""What a sensor can do, of the last output channel or the one named; the agent raises the channel's alarm."""

KNOWN: Mapping[str, Mapping[str, FaultKind]] = {
    "can": {**LINES, **_ON_TEXT, **FRAMES, **COUNTERS, **NUMBERS},
    "serial": {**LINES, **BYTES, **COUNTERS, **NUMBERS},
    "modbus": {**REPLIES, **NUMBERS},
    "sensor": SENSORS,
}
"""The faults of each driver's devices, and of sensors: a fault is called `<driver>.<name>`."""


def names() -> list[str]:
    """Return every fault's whole name."""
    return [f"{driver}.{name}" for driver, faults in KNOWN.items() for name in faults]
