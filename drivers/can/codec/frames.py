"""CAN frames as rows of a numpy table, laid out like the kernel's own canfd_frame. Pure: no I/O."""

import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.can.tuning import SHOWN_BYTES
from drivers.port import IntArray

EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
FD_FLAG = 0x04
STANDARD_MASK = 0x7FF
EXTENDED_MASK = 0x1FFFFFFF  # fixed by linux/can.h
MOST_SECONDS = 9_000_000_000
"""Fixed by 64 bits: a time stamp beyond does not fit into 64 bits of nanoseconds."""
FD_LENGTHS = (*range(9), 12, 16, 20, 24, 32, 48, 64)

FRAME = np.dtype(
    [("id", "<u4"), ("length", "u1"), ("flags", "u1"), ("reserved", "<u2"), ("data", "u1", (72,))]
)
"""One frame: identifier with the flag bits above, data padded by eight bytes so that a 64-bit number can be
read from any byte of it."""

_ROW = struct.Struct("<IBBxx72s")

FrameTable = NDArray[np.void]


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames in the order of their arrival.

    Attributes:
        table: (n,) of dtype FRAME.
        t_ns: (n,) time stamps of the kernel, the daemon or the log, ns.
    """

    table: FrameTable
    t_ns: IntArray

    def __len__(self) -> int:
        return len(self.table)


def pack_frame(identifier: int, data: bytes, flags: int = 0, length: int | None = None) -> bytes:
    """Return one frame as a row of the table."""
    return _ROW.pack(identifier, len(data) if length is None else length, flags, data)


def frames_of(rows: Sequence[bytes], t_ns: IntArray) -> Frames:
    """Return packed rows as a table."""
    return Frames(np.frombuffer(b"".join(rows), FRAME), t_ns)


def joined(first: Frames, second: Frames) -> Frames:
    """Return two tables as one."""
    if not len(second):
        return first
    return Frames(np.concatenate([first.table, second.table]), np.concatenate([first.t_ns, second.t_ns]))


def no_frames() -> Frames:
    """Return an empty table."""
    return Frames(np.empty(0, FRAME), np.empty(0, np.int64))


def identifier(digits: str, extended: bool) -> int:
    """Return an identifier written in hexadecimal with its flag; ValueError beyond its 11 or 29 bits."""
    number = int(digits, 16)
    if number > (EXTENDED_MASK if extended else STANDARD_MASK):
        raise ValueError(f"identifier {digits} has too many bits")
    return number | EXTENDED if extended else number


_SOCKETCAND = re.compile(
    rb"< *(?:frame ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) (\d{1,12})\.(\d{1,9})(?: +((?:[0-9A-Fa-f]{2} ?){0,64}))? *"
    rb"|(error|hi|ok|echo) ?[^<>]*"
    rb"|rtr ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) (\d{1,12})\.(\d{1,9}) +([0-8]) *)>"
)
"""What a daemon says: a frame; a word by itself; a remote frame, which older daemons keep to themselves."""


@dataclass(slots=True)
class DaemonText:
    """What socketcand sends in raw mode, put together from pieces; keeps at most one unfinished message.

    Attributes:
        bad: messages that were no frame, so far.
        shown: the newest of them.
    """

    bad: int = 0
    shown: str = ""
    _rest: bytes = b""

    def feed(self, data: bytes) -> Frames:
        """Return the frames that are whole now."""
        text = self._rest + data
        end = text.rfind(b">") + 1
        whole, self._rest = text[:end], text[end:][-_LONGEST_MESSAGE:]
        rows: list[bytes] = []
        times: list[int] = []
        known = sum(self._add(match, rows, times) for match in _SOCKETCAND.finditer(whole))
        strange = whole.count(b">") - known
        if strange:
            self.bad += strange
            self.shown = (_SOCKETCAND.sub(b"", whole).strip() or whole)[:SHOWN_BYTES].decode("latin-1")
        return frames_of(rows, np.array(times, np.int64)) if rows else no_frames()

    def _add(self, match: re.Match[bytes], rows: list[bytes], times: list[int]) -> bool:
        """Add a message's frame, if it is one; tell whether the message makes sense."""
        word = match[5]
        if word is not None:
            if word == b"error":
                rows.append(_daemon_error(match[0]))
                times.append(0)
            return True
        seconds = int(match[2] or match[7])
        row = _daemon_frame(match) if seconds <= MOST_SECONDS else None
        if row is None:
            return False
        rows.append(row)
        times.append(seconds * 10**9 + int((match[3] or match[8]).ljust(9, b"0")))
        return True


_LONGEST_MESSAGE = 400
"""Fixed by socketcand's longest message, of an FD frame, and room to find where the next begins."""
_ERROR_CLASS = re.compile(rb"< *error ([0-9A-Fa-f]{1,8}) \d")


def _daemon_error(message: bytes) -> bytes:
    """Return an error frame of the class that the daemon names; it passes on no more of it."""
    match = _ERROR_CLASS.match(message)
    return pack_frame(ERROR | (int(match[1], 16) & EXTENDED_MASK if match else 0), bytes(8))


def _daemon_frame(match: re.Match[bytes]) -> bytes | None:
    return _daemon_row(match[1], match[4] or b"") if match[1] else _daemon_remote(match[6], int(match[9]))


def _daemon_remote(digits: bytes, length: int) -> bytes | None:
    number = _daemon_identifier(digits)
    return None if number is None else pack_frame(number | REMOTE, b"", 0, length)


def _daemon_identifier(digits: bytes) -> int | None:
    try:
        return identifier(digits.decode(), len(digits) > 3)
    except ValueError:
        return None


def _daemon_row(digits: bytes, payload: bytes) -> bytes | None:
    data = bytes.fromhex(payload.decode())
    number = _daemon_identifier(digits)
    if number is None:
        return None
    return pack_frame(number, data, FD_FLAG if len(data) > 8 else 0) if len(data) in FD_LENGTHS else None


_CANDUMP = re.compile(
    r"\((\d{1,12})\.(\d{1,9})\) +(\S+) +([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#"
    r"(?:(R)([0-8]?)|(#[0-9A-Fa-f])?((?:[0-9A-Fa-f]{2}){0,64}))(?: [TR])?",
    re.ASCII,
)


def candump_row(line: str) -> tuple[int, bytes] | None:
    """Return the time in ns and the packed frame of a line of `candump -L`; None when it is none."""
    match = _CANDUMP.fullmatch(line.strip())
    if match is None:
        return None
    row = _candump_frame(match)
    if row is None or int(match[1]) > MOST_SECONDS:
        return None
    return int(match[1]) * 10**9 + int(match[2].ljust(9, "0")), row


def _candump_frame(match: re.Match[str]) -> bytes | None:
    """Return the packed frame of a line; None where its identifier or its length is none."""
    number = _candump_identifier(match[4])
    if number is None:
        return None
    if match[5]:
        return pack_frame(number | REMOTE, b"", 0, int(match[6] or 0))
    data = bytes.fromhex(match[8])
    is_fd = match[7] is not None
    if len(data) not in (FD_LENGTHS if is_fd else FD_LENGTHS[:9]):
        return None
    return pack_frame(number, data, FD_FLAG if is_fd else 0)


def _candump_identifier(digits: str) -> int | None:
    """Return an identifier with flags; None beyond its bits. Eight digits may carry the error frame flag."""
    number = int(digits, 16)
    is_long = len(digits) == 8
    if number > (ERROR | EXTENDED_MASK if is_long else STANDARD_MASK):
        return None
    return number | EXTENDED if is_long and not number & ERROR else number


def candump_frames(lines: Iterable[str]) -> tuple[Frames, list[int]]:
    """Return the frames of lines of `candump -L`, and the places of the lines that are none."""
    rows, times, bad = [], [], []
    for place, line in enumerate(lines):
        item = candump_row(line)
        if item is not None:
            times.append(item[0])
            rows.append(item[1])
        elif line.strip():
            bad.append(place)
    return (frames_of(rows, np.array(times, np.int64)) if rows else no_frames()), bad
