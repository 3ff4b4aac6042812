"""The text of `candump -L`, many lines at once: those of one shape are one table of characters. Pure: no I/O.

A line of a shape that is not known here, and one that turns out to be wrong, is read by `can_frames.candump_row`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.can_frames import EXTENDED, FD_FLAG, FD_LENGTHS, FRAME, Frames, FrameTable, candump_row
from drivers.fields import ByteArray
from drivers.port import IntArray

_NEWLINE, _SPACE, _HASH, _OPEN, _CLOSE, _POINT = b"\n #()."
_FEW = 8
"""Lines of a shape of which there are fewer are cheaper read one by one."""
_NO_DIGIT = 99
_DIGITS = np.full(256, _NO_DIGIT, np.uint8)
for _value, _digit in enumerate(b"0123456789abcdef"):
    _DIGITS[_digit] = _DIGITS[ord(chr(_digit).upper())] = _value
_LENGTHS = {False: frozenset(FD_LENGTHS[:9]), True: frozenset(FD_LENGTHS)}


@dataclass(frozen=True, slots=True)
class _Lines:
    """Lines in a text: where each begins and ends, and its first closing bracket and number sign."""

    text: ByteArray
    start: IntArray
    end: IntArray
    close: IntArray
    sign: IntArray

    def shapes(self) -> IntArray:
        """Return a number for each line that is equal for lines of one shape; −1 where it cannot be a frame's."""
        length, close, sign = self.end - self.start, self.close - self.start, self.sign - self.start
        possible = (close > 3) & (close < 32) & (sign > close + 6) & (sign < 64) & (length > sign) & (length < 256)
        return np.where(possible, (length << 16) | (sign << 8) | close, -1)


def candump_block(text: bytes) -> tuple[Frames, list[int]]:
    """Return the frames of whole lines, in order, and the places of the lines that are none."""
    lines = _lines(np.frombuffer(text, np.uint8))
    count = len(lines.start)
    table, t_ns, read = np.zeros(count, FRAME), np.zeros(count, np.int64), np.zeros(count, np.bool_)
    shapes = lines.shapes()
    for shape, first, many in zip(*np.unique(shapes, return_index=True, return_counts=True), strict=True):
        if shape >= 0 and many >= _FEW:
            rows = np.arange(count) if many == count else np.flatnonzero(shapes == shape)
            _read_shape(lines, rows, int(first), (table, t_ns, read))
    bad = []
    for place in np.flatnonzero(~read).tolist():
        line = text[lines.start[place] : lines.end[place]].decode("latin-1")
        if (item := candump_row(line)) is not None:
            t_ns[place], table[place], read[place] = item[0], np.frombuffer(item[1], FRAME)[0], True
        elif line.strip():
            bad.append(place)
    return (Frames(table, t_ns) if read.all() else Frames(table[read], t_ns[read])), bad


def _lines(text: ByteArray) -> _Lines:
    end = np.flatnonzero(text == _NEWLINE)
    if not len(end) or end[-1] != len(text) - 1:
        end = np.append(end, len(text))
    start = np.concatenate(([0], end[:-1] + 1))
    if len(text) and text[-1] == _NEWLINE:
        start = start[: len(end)]
    return _Lines(text, start, end, _first(text, _CLOSE, start), _first(text, _HASH, start))


def _first(text: ByteArray, character: int, start: IntArray) -> IntArray:
    """Return where a character stands first from each start on; the text's length where nowhere."""
    places = np.append(np.flatnonzero(text == character), len(text))
    found: IntArray = places[np.searchsorted(places, start)]
    return found


def _read_shape(
    lines: _Lines, rows: IntArray, first: int, into: tuple[FrameTable, IntArray, NDArray[np.bool_]]
) -> None:
    """Read lines that are like the first one of them, and mark those that were."""
    table, t_ns, read = into
    start = int(lines.start[first])
    length, close, sign = (int(at[first]) - start for at in (lines.end, lines.close, lines.sign))
    cells = lines.text[lines.start[rows][:, None] + np.arange(length)]
    suffix = 2 if bytes(cells[0, -2:]) in (b" R", b" T") else 0
    name_end = sign - (9 if sign > close + 11 and cells[0, sign - 9] == _SPACE else 4)
    fd = sign + 1 < length and cells[0, sign + 1] == _HASH
    data = sign + (3 if fd else 1)
    size, odd = divmod(length - suffix - data, 2)
    point = int(np.argmax(cells[0, :close] == _POINT))
    if (
        odd
        or name_end < close + 3
        or size not in _LENGTHS[bool(fd)]
        or not 0 < point < close - 1
        or close - point > 10
        or point > 13
    ):
        return
    digits = _DIGITS[cells]
    right = _marked(cells, (close, point, name_end, sign), length, suffix) & _are_digits(
        digits, (1, point, close, name_end, sign, data, length - suffix)
    )
    numbers = digits[:, name_end + 1 : sign]
    identifier = _value_of(numbers, 16)
    right &= identifier <= (0x7FF if numbers.shape[1] == 3 else 0x1FFFFFFF)
    if fd:
        right &= (cells[:, sign + 1] == _HASH) & (digits[:, sign + 2] < 16)
    pairs = digits[:, data : length - suffix]
    made = np.zeros(len(rows), FRAME)
    made["id"] = identifier + (EXTENDED if numbers.shape[1] == 8 else 0)
    made["length"], made["flags"] = size, FD_FLAG if fd else 0
    made["data"][:, :size] = (pairs[:, ::2] << 4) | (pairs[:, 1::2] & 15)
    table[rows], read[rows] = made, right
    t_ns[rows] = _value_of(digits[:, 1:point], 10) * 10**9
    t_ns[rows] += _value_of(digits[:, point + 1 : close], 10) * 10 ** (9 - (close - point - 1))


def _marked(cells: ByteArray, marks: tuple[int, int, int, int], length: int, suffix: int) -> NDArray[np.bool_]:
    """Tell of each line whether brackets, point, spaces and sign stand where the first line has them."""
    close, point, name_end, sign = marks
    right = (cells[:, 0] == _OPEN) & (cells[:, point] == _POINT) & (cells[:, close] == _CLOSE)
    right &= (cells[:, close + 1] == _SPACE) & (cells[:, name_end] == _SPACE) & (cells[:, sign] == _HASH)
    # the bus's name: no white space in it
    right &= np.all(cells[:, close + 2 : name_end] > _SPACE, axis=1)
    if suffix:
        right &= (cells[:, length - 2] == _SPACE) & ((cells[:, -1] == ord("R")) | (cells[:, -1] == ord("T")))
    marked: NDArray[np.bool_] = right
    return marked


def _are_digits(digits: ByteArray, at: tuple[int, int, int, int, int, int, int]) -> NDArray[np.bool_]:
    """Tell of each line whether seconds, their parts, identifier and data are digits of their kind."""
    seconds, point, close, name_end, sign, data, end = at
    right = (digits[:, seconds:point] < 10).all(axis=1) & (digits[:, point + 1 : close] < 10).all(axis=1)
    right &= (digits[:, name_end + 1 : sign] < 16).all(axis=1) & (digits[:, data:end] < 16).all(axis=1)
    found: NDArray[np.bool_] = right
    return found


def _value_of(digits: ByteArray, base: int) -> IntArray:
    """Return the numbers that rows of digits (n, k) write, (n,)."""
    powers = base ** np.arange(digits.shape[1], dtype=np.int64)[::-1]
    value: IntArray = digits.astype(np.int64) @ powers
    return value
