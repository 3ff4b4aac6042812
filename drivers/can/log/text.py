"""The text of `candump -L`, many lines at once: those of one shape are one table of characters. Pure: no I/O.

A line of a shape that is not known here, and one that turns out to be wrong, is read by
`drivers.can.codec.frames.candump_row`.
"""

from dataclasses import dataclass

import numpy as np

from drivers.can.codec.frames import (
    EXTENDED,
    EXTENDED_MASK,
    FD_FLAG,
    FD_LENGTHS,
    FRAME,
    MOST_SECONDS,
    STANDARD_MASK,
    Frames,
    FrameTable,
    candump_row,
)
from drivers.can.tuning import FEW_OF_A_SHAPE
from drivers.fields import ByteArray
from drivers.port import BoolArray, IntArray

_NEWLINE, _SPACE, _HASH, _OPEN, _CLOSE, _POINT = b"\n #()."
_NO_DIGIT = 99  # fixed by this table: marks what is no hexadecimal digit
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
        """Return a number for each line, equal for lines of one shape; −1 where it cannot be a frame's."""
        length, close, sign = self.end - self.start, self.close - self.start, self.sign - self.start
        possible = (
            (close > 3) & (close < 32) & (sign > close + 6) & (sign < 64) & (length > sign) & (length < 256)
        )
        return np.where(possible, (length << 16) | (sign << 8) | close, -1)

    def cells(self, rows: IntArray | None, size: int) -> ByteArray:
        """Return lines of one length, all or some, as a table of characters; all of a text are not copied."""
        table: ByteArray
        if rows is None and len(self.text) == len(self.start) * (size + 1):
            table = self.text.reshape(-1, size + 1)[:, :size]
        else:
            start = self.start if rows is None else self.start[rows]
            table = self.text[start[:, None] + np.arange(size)]
        return table


def candump_block(text: bytes, wire: bytes | None = None) -> tuple[Frames, list[int]]:
    """Return the frames of whole lines, in order, and the places of the lines that are none.

    wire: the interface whose frames are returned; by default those of all are.
    """
    lines = _lines(np.frombuffer(text, np.uint8))
    count = len(lines.start)
    table, t_ns, read = np.zeros(count, FRAME), np.zeros(count, np.int64), np.zeros(count, np.bool_)
    shapes = lines.shapes()
    for shape, first, many in zip(*np.unique(shapes, return_index=True, return_counts=True), strict=True):
        if shape >= 0 and many >= FEW_OF_A_SHAPE:
            rows = None if many == count else np.flatnonzero(shapes == shape)
            _read_shape(lines, rows, int(first), (table, t_ns, read))
    bad = _read_alone(text, lines, (table, t_ns, read))
    if wire is not None:
        read &= _named(lines, wire)
    return (Frames(table, t_ns) if read.all() else Frames(table[read], t_ns[read])), bad


def _named(lines: _Lines, wire: bytes) -> BoolArray:
    """Tell of each line that is a frame whether it names an interface."""
    begin = lines.close + 1
    padded = np.append(lines.text, np.zeros(len(wire) + 3, np.uint8))
    # behind the bracket tools write one space, hands may write more
    while (blank := padded[begin] == _SPACE).any():
        begin = begin + blank
    same = np.ones(len(begin), np.bool_)
    for place, character in enumerate(wire + b" "):
        same &= padded[begin + place] == character
    return same


def _read_alone(text: bytes, lines: "_Lines", into: tuple[FrameTable, IntArray, BoolArray]) -> list[int]:
    """Read one by one the lines whose shape is seldom; return the places of those that are no frame."""
    table, t_ns, read = into
    bad = []
    for place in np.flatnonzero(~read).tolist():
        line = text[lines.start[place] : lines.end[place]].decode("latin-1")
        item = candump_row(line)
        if item is not None:
            t_ns[place] = item[0]
            table[place] = np.frombuffer(item[1], FRAME)[0]
            read[place] = True
        elif line.strip():
            bad.append(place)
    return bad


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


@dataclass(frozen=True, slots=True)
class _Shape:
    """Where things stand in lines of a shape: columns of point, closing bracket, end of name, sign and data.

    `end` is where the data end, before the direction that python-can writes there.
    """

    point: int
    close: int
    name_end: int
    sign: int
    data: int
    end: int
    fd: bool

    @property
    def size(self) -> int:
        """Bytes of data."""
        return (self.end - self.data) // 2

    def possible(self) -> bool:
        """Tell whether frames can be written so."""
        whole = (self.end - self.data) % 2 == 0 and self.size in _LENGTHS[self.fd]
        return (
            whole
            and 1 < self.point <= 13
            and 1 < self.close - self.point <= 10
            and self.name_end > self.close + 2
        )

    def marked(self, cells: ByteArray) -> BoolArray:
        """Tell of each line whether brackets, point, spaces and signs stand where the first line has them."""
        right: BoolArray = (cells[:, 0] == _OPEN) & (cells[:, self.point] == _POINT)
        right &= (cells[:, self.close] == _CLOSE) & (cells[:, self.close + 1] == _SPACE)
        right &= (cells[:, self.name_end] == _SPACE) & (cells[:, self.sign] == _HASH)
        right &= _each(cells[:, self.close + 2 : self.name_end] > _SPACE)
        if self.fd:
            right &= cells[:, self.sign + 1] == _HASH
        if self.end < cells.shape[1]:
            right &= (cells[:, self.end] == _SPACE) & (
                (cells[:, -1] == ord("R")) | (cells[:, -1] == ord("T"))
            )
        return right

    def in_digits(self, digits: ByteArray) -> BoolArray:
        """Tell of each line if seconds, their parts, identifier, flags and data are digits of their kind."""
        right = _each(digits[:, 1 : self.point] < 10)
        right &= _each(digits[:, self.point + 1 : self.close] < 10)
        right &= _each(digits[:, self.name_end + 1 : self.sign] < 16)
        right &= _each(digits[:, self.sign + 1 + self.fd : self.end] < 16)
        return right


def _each(right: BoolArray) -> BoolArray:
    """Tell of each row whether all of it is right; mostly everything is, and to see that costs a tenth."""
    return np.ones(len(right), np.bool_) if right.all() else np.asarray(right.all(axis=1))


def _shape(line: ByteArray, close: int, sign: int) -> _Shape:
    """Return the shape of a line."""
    is_long = sign > close + 11 and line[sign - 9] == _SPACE
    is_fd = bytes(line[sign + 1 : sign + 2]) == b"#"
    has_direction = bytes(line[-2:]) in (b" R", b" T")
    name = sign - (9 if is_long else 4)
    data = sign + (3 if is_fd else 1)
    end = len(line) - 2 * has_direction
    point = int(np.argmax(line[:close] == _POINT))
    return _Shape(point, close, name, sign, data, end, is_fd)


def _read_shape(
    lines: _Lines, rows: IntArray | None, first: int, into: tuple[FrameTable, IntArray, BoolArray]
) -> None:
    """Read lines, all or some, that are like the first one of them, and mark those that were."""
    table, t_ns, read = into
    start, end = int(lines.start[first]), int(lines.end[first])
    shape = _shape(lines.text[start:end], int(lines.close[first]) - start, int(lines.sign[first]) - start)
    if not shape.possible():
        return
    cells = lines.cells(rows, end - start)
    digits = _DIGITS[cells]
    name, pairs = digits[:, shape.name_end + 1 : shape.sign], digits[:, shape.data : shape.end]
    identifier = _value_of(name, 16)
    extended = name.shape[1] == 8
    right = shape.marked(cells) & shape.in_digits(digits)
    seconds = _value_of(digits[:, 1 : shape.point], 10)
    parts = digits[:, shape.point + 1 : shape.close]
    right &= (identifier <= (EXTENDED_MASK if extended else STANDARD_MASK)) & (seconds <= MOST_SECONDS)
    made = table if rows is None else np.zeros(len(rows), FRAME)
    made["id"] = identifier + (EXTENDED if extended else 0)
    made["length"] = shape.size
    made["flags"] = FD_FLAG if shape.fd else 0
    made["data"][:, : shape.size] = (pairs[:, ::2] << 4) | (pairs[:, 1::2] & 15)
    times = seconds * 10**9 + _value_of(parts, 10) * 10 ** (9 - parts.shape[1])
    if rows is None:
        t_ns[:], read[:] = times, right
    else:
        table[rows], t_ns[rows], read[rows] = made, times, right


def _value_of(digits: ByteArray, base: int) -> IntArray:
    """Return the numbers that rows of digits (n, k) write, (n,)."""
    # up to 13 digits are exact in floating point, whose products are several times quicker
    powers = float(base) ** np.arange(digits.shape[1])[::-1]
    value: IntArray = (digits.astype(np.float64) @ powers).astype(np.int64)
    return value
