"""Frames as serial adapters write them (slcan): lines of ASCII, read so that no byte can do harm. Pure.

Understood are the letters of Lawicel's protocol, CANable's for FD frames, and the state and error lines that
the kernel's driver understands too. A line ends with a carriage return, or with the bell of an adapter that
refuses.
"""

import re
from binascii import unhexlify
from collections.abc import Callable

import numpy as np

from drivers.can.codec.frames import (
    ERROR,
    EXTENDED,
    FD_FLAG,
    FD_LENGTHS,
    REMOTE,
    Frames,
    frames_of,
    no_frames,
    pack_frame,
)
from drivers.port import Counts, IntArray

WRAP_MS = 60_000
"""Fixed by LAWICEL CAN232: where adapters' time stamps of 16 bits begin anew."""
REFUSED = "adapter refuses"
_LONGEST = 160  # fixed by the longest line, of an FD frame with its time stamp, 64 bytes in hexadecimal
_LINE = re.compile(rb"([^\r\a]*)([\r\a])")
_FRAME = re.compile(
    rb"(?:([trdb])([0-7][0-9A-Fa-f]{2})|([TRDBx])([01][0-9A-Fa-f]{7}))([0-9A-Fa-f])((?:[0-9A-Fa-f]{2})*)"
)
_STATE = re.compile(rb"s([awpb])(\d{3})(\d{3})")
_ERRORS = re.compile(rb"e([1-9])([abBcfoOs]{1,9})")
_STATUS = re.compile(rb"F([0-9A-Fa-f]{2})")
_OTHER = re.compile(rb"|[zZ]|V[0-9A-Fa-f]{4}|v[0-9A-Fa-f]{1,4}|N[0-9A-Za-z]{4}")
_LETTERS, _FD_LETTERS = b"tTrRxdDbB", b"dDbB"
_LONGEST_HEAD = 10  # fixed by letter, identifier and length of an extended frame
_HEAD = re.compile(rb"(?:[trdb][0-9A-Fa-f]{3}|[TRDBx][0-9A-Fa-f]{8})([0-9A-Fa-f])")
_STATES = {b"a": 0x40, b"w": 0x0C, b"p": 0x30}
_STATUS_BITS = {
    0x01: (0x4, 0x01),
    0x04: (0x4, 0x04),
    0x08: (0x4, 0x01),
    0x20: (0x4, 0x10),
    0x40: (0x2, 0),
    0x80: (0x80, 0),
}
"""What each bit of a status reply means as (class, controller bits) of an error frame."""


class SlcanText:
    """What an adapter sends, put together from pieces; keeps at most one unfinished line.

    Args:
        counts: told of lines that are no frame (received and rejected "text"), and of refusals (faults).
        fd: whether the letters of FD frames are known.

    Of a line one cannot tell whether its beginning is missing, but by its first letter. The letters of FD
    frames are digits too: such a line does not count where it may be the end of the broken one before it.
    """

    def __init__(self, counts: Counts, *, fd: bool = True) -> None:
        self._counts = counts
        self._fd = fd
        self._rest = b""
        self._begun = False
        self._broken: bytes | None = b""
        self._clock = StampClock()

    def feed(self, data: bytes, arrival_ns: int) -> Frames:
        """Return the frames that are whole now; arrival_ns is the time of those that bring no stamp."""
        rows: list[bytes] = []
        stamps: list[int] = []
        text = self._rest + data
        end = max(text.rfind(b"\r"), text.rfind(b"\a")) + 1
        for match in _LINE.finditer(text, 0, end):
            self._take(match[1], match[2] == b"\a", rows, stamps)
        self._rest = text[end:][-_LONGEST:]
        return frames_of(rows, self._clock.times(stamps, arrival_ns)) if rows else no_frames()

    def _take(self, line: bytes, refused: bool, rows: list[bytes], stamps: list[int]) -> None:
        first, self._begun = not self._begun, True
        item = None if refused or self._may_be_tail(line) else _read(line)
        self._broken = None
        if item is not None:
            rows += item[0]
            stamps += [item[1]] * len(item[0])
        elif refused and not line:
            self._counts.faults[REFUSED] += 1
        else:
            self._broken = line
            if not first:  # the line that was being sent while this end was opened is nobody's
                self._counts.received += 1
                self._counts.rejected["text"] += 1
                self._counts.show_bad("text", line.decode("latin-1"))

    def _may_be_tail(self, line: bytes) -> bool:
        """Tell whether a line could be the end of the broken one before it, cut by a wrong or extra byte."""
        if line[:1] not in _FD_LETTERS or not line:
            return False
        if not self._fd:
            return True
        if self._broken is None:
            return False
        head = _HEAD.match(self._broken)
        if head is None:
            return len(self._broken) < _LONGEST_HEAD or self._broken[:1] not in _LETTERS
        missing = len(head[0]) + 2 * FD_LENGTHS[int(head[1], 16)] - len(self._broken) - len(line)
        return missing in (0, 1, -4, -3)


class StampClock:
    """Frame times from the adapter's milliseconds, which restart every minute, held to the arrival time."""

    def __init__(self) -> None:
        self._ms: int | None = None
        self._at_ns = 0
        self._arrived_ns = 0

    def times(self, stamps: list[int], arrival_ns: int) -> IntArray:
        """Return times (n,) of stamps, ms; −1 for none, which takes that of the newest one, or of arrival."""
        if self._ms is None and max(stamps) < 0:
            return np.full(len(stamps), arrival_ns)
        return np.array([self._time(ms, arrival_ns) for ms in stamps], np.int64)

    def _time(self, ms: int, arrival_ns: int) -> int:
        if ms < 0:
            return arrival_ns if self._ms is None else self._at_ns
        if self._ms is None:
            self._at_ns = arrival_ns
        else:
            self._at_ns += self._step_ms(ms - self._ms, arrival_ns - self._arrived_ns) * 1_000_000
        self._ms, self._arrived_ns = ms, arrival_ns
        return self._at_ns

    def _step_ms(self, step: int, passed_ns: int) -> int:
        """Return the step without its wraps: that nearest to what has passed here."""
        step %= WRAP_MS
        return step + WRAP_MS * max(0, round((passed_ns / 1e6 - step) / WRAP_MS))


def _read(line: bytes) -> tuple[list[bytes], int] | None:
    """Return a line's rows and stamp, ms (−1: none); no rows for one without a frame, None for nonsense."""
    for form, rows_of in _WITHOUT_STAMP:
        match = form.fullmatch(line)
        rows = None if match is None else rows_of(match)
        if rows is not None:
            return rows, -1
    match = _FRAME.fullmatch(line)
    return None if match is None else _frame(match)


def _frame(match: re.Match[bytes]) -> tuple[list[bytes], int] | None:
    standard, digits, extended, long_digits, code, payload = match.groups()
    number = int(long_digits, 16) | EXTENDED if extended else int(digits, 16)
    letter = extended or standard
    length = FD_LENGTHS[int(code, 16)]
    flags = FD_FLAG if letter in _FD_LETTERS else 0
    if length > 8 and not flags:
        return None
    if letter in b"rR":
        return _stamped(pack_frame(number | REMOTE, b"", 0, length), payload)
    size = 2 * length
    if len(payload) < size:
        return None
    return _stamped(pack_frame(number, unhexlify(payload[:size]), flags), payload[size:])


def _stamped(row: bytes, digits: bytes) -> tuple[list[bytes], int] | None:
    stamp = _stamp(digits)
    return None if stamp is None else ([row], stamp)


def _stamp(digits: bytes) -> int | None:
    """Return the milliseconds behind a frame, −1 where nothing stands, None where something else does."""
    if not digits:
        return -1
    ms = int(digits, 16) if len(digits) == 4 else WRAP_MS
    return ms if ms < WRAP_MS else None


def _state(match: re.Match[bytes]) -> bytes:
    if match[1] == b"b":
        return pack_frame(ERROR | 0x40, bytes(8))
    received, sent = (min(255, int(count)) for count in (match[2], match[3]))
    return pack_frame(ERROR | 0x4 | 0x200, bytes((0, _STATES[match[1]], 0, 0, 0, 0, sent, received)))


def _error(kind: int, controller: int) -> bytes:
    return pack_frame(ERROR | kind, bytes((0, int(controller), 0, 0, 0, 0, 0, 0)))


def _states(match: re.Match[bytes]) -> list[bytes]:
    return [_state(match)]


def _errors(match: re.Match[bytes]) -> list[bytes] | None:
    """Return an error frame for each letter; None where their number is not the one that is said."""
    letters = match[2].decode()
    if len(letters) != int(match[1]):
        return None
    return [_error(*_ERROR_LETTERS.get(letter, (0x8, 0))) for letter in letters]


def _flags(match: re.Match[bytes]) -> list[bytes]:
    flags = int(match[1], 16)
    return [_error(kind, bits) for bit, (kind, bits) in _STATUS_BITS.items() if flags & bit]


def _nothing(_: re.Match[bytes]) -> list[bytes]:
    return []


_ERROR_LETTERS = {"a": (0x20, 0), "o": (0x4, 1), "O": (0x4, 1)}
"""Class of an error frame and its controller byte; all other letters are of the protocol."""
_WITHOUT_STAMP: tuple[tuple[re.Pattern[bytes], Callable[[re.Match[bytes]], list[bytes] | None]], ...] = (
    (_STATE, _states), (_ERRORS, _errors), (_STATUS, _flags), (_OTHER, _nothing),
)  # fmt: skip
"""Lines that carry no frame of the bus, and what makes error frames of them."""
