"""Bytes of a serial line to samples: frames with sync, fields and check, or lines of text. Pure: no I/O.

Both decoders take bytes in pieces of any size, keep at most one unfinished frame or line, and find the next good one
behind whatever is wrong.
"""

import math
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.crc import Crc
from drivers.fields import ByteArray, Layout
from drivers.port import Counts, DriverConfigError, FloatArray, IntArray

Samples = tuple[FloatArray, IntArray | None]
"""Values (n, m) and counters (n,), or None without a counter."""

_LONGEST_LINE = 1024
_FLUSH_FRAMES = 16


class SerialDecoder(ABC):
    """Finds samples in a stream of bytes."""

    modulus: int | None = None

    @abstractmethod
    def restart(self) -> None:
        """Forget what is unfinished: the line was opened anew and may begin amid a frame."""

    @abstractmethod
    def feed(self, data: bytes) -> Samples:
        """Return the samples that are whole now."""

    @abstractmethod
    def resolution(self) -> tuple[float, ...]:
        """Smallest step of each field."""


class BinaryDecoder(SerialDecoder):
    """Frames of one length: sync bytes, packed fields, check (low byte first, over all after sync).

    Bytes between good frames are counted as so many bad frames ("crc" when one of them began with the sync bytes,
    else "sync") as they make up, or, when fewer than half a frame, as stray.
    """

    def __init__(
        self, sync: bytes, layout: Layout, crc: Crc | None, names: Sequence[str], counter: str | None, counts: Counts
    ) -> None:
        self._sync = np.frombuffer(sync, np.uint8)
        self._layout = layout
        self._crc = crc
        self._names = tuple(names)
        self._counter = counter
        self._counts = counts
        self._size = len(sync) + layout.size + (crc.size if crc else 0)
        self._steps = layout.resolution(self._names)
        self.modulus = layout.counter_field(counter).modulus if counter else None
        self.restart()

    def restart(self) -> None:
        self._rest = b""
        self._skipped = 0
        self._crc_failed = False
        self._begun = False

    def resolution(self) -> tuple[float, ...]:
        return self._steps

    def feed(self, data: bytes) -> Samples:
        text = np.frombuffer(self._rest + data, np.uint8)
        starts, failed = self._frames(text)
        end = self._account(starts, failed)
        kept = max(end, len(text) - self._size + 1)
        self._skip(kept - end, bool(((failed >= end) & (failed < kept)).any()))
        if self._skipped >= _FLUSH_FRAMES * self._size:
            self._settle()
        self._rest = text[kept:].tobytes()
        return self._samples(text, starts)

    def _frames(self, text: ByteArray) -> tuple[IntArray, IntArray]:
        """Return where the good frames begin, and where bytes begin that look like a frame and are none."""
        places = self._candidates(text)
        good = self._sound(text, places)
        return _apart(places[good], self._size), places[~good]

    def _candidates(self, text: ByteArray) -> IntArray:
        last = len(text) - self._size + 1
        if last <= 0:
            return np.empty(0, np.int64)
        match = np.ones(last, np.bool_)
        for place, byte in enumerate(self._sync):
            match &= text[place : place + last] == byte
        return np.flatnonzero(match)

    def _rows(self, text: ByteArray, places: IntArray) -> ByteArray:
        """Return what follows the sync bytes of each frame, (n, fields and check)."""
        first = len(self._sync)
        rows: ByteArray = text[places[:, None] + np.arange(first, self._size)]
        return rows

    def _sound(self, text: ByteArray, places: IntArray) -> NDArray[np.bool_]:
        if self._crc is None:
            return self._followed(text, places)
        rows = self._rows(text, places)
        body, check = rows[:, : self._layout.size], rows[:, self._layout.size :]
        good: NDArray[np.bool_] = (self._crc.bytes_of(body) == check).all(axis=1)
        return good

    def _followed(self, text: ByteArray, places: IntArray) -> NDArray[np.bool_]:
        """Tell of frames without a check whether the next sync bytes follow, as far as they have come."""
        good = np.ones(len(places), np.bool_)
        for place, byte in enumerate(self._sync):
            following = places + self._size + place
            there = following < len(text)
            good &= ~there | (text[np.minimum(following, len(text) - 1)] == byte)
        return good

    def _account(self, starts: IntArray, failed: IntArray) -> int:
        """Count what lies between the good frames; return where the last of them ends."""
        end = 0
        if len(starts) and not len(failed) and starts[0] == 0 and not self._skipped:
            jumps = np.flatnonzero(np.diff(starts) != self._size)
            if not len(jumps):
                self._begun = True
                return int(starts[-1]) + self._size
        for start in starts.tolist():
            self._skip(start - end, bool(((failed >= end) & (failed < start)).any()))
            self._settle()
            self._begun = True
            end = start + self._size
        return end

    def _skip(self, count: int, crc_failed: bool) -> None:
        self._skipped += count
        self._crc_failed |= crc_failed and count > 0

    def _settle(self) -> None:
        """Count the bytes skipped so far. The piece of a frame amid which the line was opened is nobody's sample."""
        frames = self._skipped // self._size if not self._begun else round(self._skipped / self._size)
        if frames:
            self._counts.received += frames
            self._counts.rejected["crc" if self._crc_failed else "sync"] += frames
        elif self._skipped:
            self._counts.faults["stray bytes"] += self._skipped
        self._skipped = 0
        self._crc_failed = False

    def _samples(self, text: ByteArray, starts: IntArray) -> Samples:
        body = self._rows(text, starts)[:, : self._layout.size]
        self._counts.received += len(starts)
        counter = self._layout.counter(body, self._counter) if self._counter else None
        return self._layout.values(body, self._names), counter


def _apart(places: IntArray, size: int) -> IntArray:
    """Return the places but for those that lie within a frame that began before."""
    if len(places) < 2 or (np.diff(places) >= size).all():
        return places
    kept = [int(places[0])]
    for place in places[1:].tolist():
        if place >= kept[-1] + size:
            kept.append(place)
    return np.array(kept, np.int64)


class TextDecoder(SerialDecoder):
    """Lines of delimited text, or lines that a pattern with named groups matches whole.

    With checksum "nmea" a line is `$ADDRESS,cells*HH`: the address is passed over, HH is the exclusive or of what
    lies between $ and *. Rejects by "checksum", "columns", "pattern" and "text" (a cell that is no number); an empty
    cell is a missing value. Without a checksum the piece of a line amid which the port was opened is passed over.
    """

    def __init__(
        self,
        columns: Sequence[str],
        delimiter: str | None,
        pattern: re.Pattern[str] | None,
        nmea: bool,
        names: Sequence[str],
        counter: str | None,
        counts: Counts,
    ) -> None:
        self._columns = tuple(columns)
        self._delimiter = delimiter
        self._pattern = pattern
        self._nmea = nmea
        self._places = [self._place(name) for name in names]
        self._counter = self._place(counter) if counter else None
        self._counts = counts
        self.restart()

    def restart(self) -> None:
        self._rest = b""
        self._begun = self._nmea

    def resolution(self) -> tuple[float, ...]:
        return (0.0,) * len(self._places)

    def _place(self, name: str) -> int:
        if name not in self._columns:
            raise DriverConfigError(f'no column is called "{name}"; columns are {", ".join(self._columns)}')
        return self._columns.index(name)

    def feed(self, data: bytes) -> Samples:
        *lines, rest = (self._rest + data).split(b"\n")
        if len(rest) > _LONGEST_LINE:
            self._counts.faults["stray bytes"] += len(rest)
            rest, self._begun = b"", False
        if lines and not self._begun:
            self._counts.faults["stray bytes"] += len(lines.pop(0))
            self._begun = True
        self._rest = rest
        rows = [row for line in lines if line.strip() and (row := self._row(line)) is not None]
        table = np.array(rows).reshape(len(rows), len(self._columns))
        counter = None if self._counter is None else table[:, self._counter].astype(np.int64)
        return table[:, self._places], counter

    def _row(self, line: bytes) -> list[float] | None:
        """Return the numbers of a line, or None with the reason counted."""
        self._counts.received += 1
        row = self._cells(line.decode("latin-1").strip("\r\n \0"))
        if isinstance(row, str):
            self._counts.rejected[row] += 1
            return None
        return row

    def _cells(self, line: str) -> list[float] | str:
        body = _nmea_body(line) if self._nmea else line
        if body is None:
            return "checksum"
        if self._pattern is not None:
            match = self._pattern.fullmatch(body)
            return _numbers([match[name] for name in self._columns], self._counter) if match else "pattern"
        cells = body.split(self._delimiter)
        if self._nmea:
            cells = cells[1:]
        return _numbers(cells, self._counter) if len(cells) == len(self._columns) else "columns"


def _nmea_body(line: str) -> str | None:
    start, star = line.find("$"), line.rfind("*")
    if start < 0 or not re.fullmatch("[0-9A-Fa-f]{2}", line[star + 1 :]) or star < start:
        return None
    body = line[start + 1 : star]
    check = 0
    for byte in body.encode("latin-1"):
        check ^= byte
    return body if check == int(line[star + 1 :], 16) else None


def _numbers(cells: Sequence[str | None], counter: int | None) -> list[float] | str:
    try:
        numbers = [float(cell) if cell and cell.strip() else float("nan") for cell in cells]
    except ValueError:
        return "text"
    if any(math.isinf(number) for number in numbers):
        return "text"
    if counter is not None and not (numbers[counter].is_integer() and 0 <= numbers[counter] < 2**53):
        return "counter"
    return numbers
