"""Tables of numbers written as text, a chunk of whole lines at a time: fast where every cell is a number.

A chunk whose every cell is a number or empty goes through numpy at once; any other is read row by row, and
each cell that is no number is reported with its line.
"""

import csv
import io
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.fields import ByteArray
from drivers.port import FloatArray, IntArray
from drivers.timestamps import column_to_ns, text_to_ns

_NEWLINE, _QUOTE, _CR = 10, 34, 13  # fixed by ASCII
NO_TIME = int(np.iinfo(np.int64).min)
"""Stands for a time that could not be read."""


@dataclass(frozen=True)
class Table:
    """How to read the lines of a table.

    Attributes:
        delimiter: the character between cells.
        width: number of columns.
        time: column of the time stamps, or None.
        columns: columns of the values, in the order asked for.
        report: told of each cell that is no number: (line in the chunk, column, text).
    """

    delimiter: str
    width: int
    time: int | None
    columns: tuple[int, ...]
    report: Callable[[int, int, str], None]

    def read(self, chunk: bytes) -> tuple[IntArray | None, FloatArray]:
        """Return times in ns (n,) (NO_TIME if unreadable; None without a time column) and values (n, m)."""
        if b"\r" in chunk:
            chunk = chunk.replace(b"\r\n", b"\n")
        if not chunk.endswith(b"\n"):
            chunk += b"\n"
        marks = self._marks(np.frombuffer(chunk, np.uint8))
        values = None if marks is None else self._fast_values(chunk, marks)
        if marks is None or values is None:
            return self._slow(chunk)
        return self._times(chunk, marks), values

    def _marks(self, text: ByteArray) -> IntArray | None:
        """Return where each cell ends, (n, width); None unless every line has `width` plain cells."""
        if (text == _QUOTE).any() or (text == _CR).any():
            return None
        newline = text == _NEWLINE
        marks = np.flatnonzero(newline | (text == ord(self.delimiter)))
        if len(marks) % self.width:
            return None
        table = marks.reshape(-1, self.width)
        ends_lines = newline[table]
        return table if ends_lines[:, -1].all() and not ends_lines[:, :-1].any() else None

    def _fast_values(self, chunk: bytes, marks: IntArray) -> FloatArray | None:
        flat = marks.reshape(-1)
        if flat[0] == 0 or (np.diff(flat) == 1).any():
            chunk = _fill_empty(chunk, flat)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                values = np.loadtxt(
                    io.BytesIO(chunk), delimiter=self.delimiter, usecols=self.columns, comments=None, ndmin=2
                )
        except ValueError:
            return None
        return values if len(values) == len(marks) and not np.isinf(values).any() else None

    def _times(self, chunk: bytes, marks: IntArray) -> IntArray | None:
        if self.time is None:
            return None
        flat = marks.reshape(-1)
        starts = np.concatenate(([0], flat[:-1] + 1)).reshape(marks.shape)[:, self.time]
        ends = marks[:, self.time]
        fast = column_to_ns(np.frombuffer(chunk, np.uint8), starts, ends)
        if fast is not None:
            return fast
        pairs = zip(starts.tolist(), ends.tolist(), strict=True)
        return np.array(
            [self._time(chunk[a:b].decode("utf-8", "replace"), i) for i, (a, b) in enumerate(pairs)]
        )

    def _time(self, text: str, line: int) -> int:
        nanoseconds = text_to_ns(text)
        if nanoseconds is None:
            self.report(line, self.time or 0, text)
            return NO_TIME
        return nanoseconds

    def _slow(self, chunk: bytes) -> tuple[IntArray | None, FloatArray]:
        lines = chunk.decode("utf-8", "replace").split("\n")
        rows = [(i, self._cells(line)) for i, line in enumerate(lines) if line.strip()]
        values = np.array([self._row(i, cells) for i, cells in rows]).reshape(-1, len(self.columns))
        if self.time is None:
            return None, values
        return np.array([self._time(_cell(cells, self.time), i) for i, cells in rows], np.int64), values

    def _cells(self, line: str) -> Sequence[str]:
        try:
            return next(csv.reader([line], delimiter=self.delimiter))
        except csv.Error:
            return line.split(self.delimiter)

    def _row(self, line: int, cells: Sequence[str]) -> list[float]:
        return [self._value(line, column, _cell(cells, column)) for column in self.columns]

    def _value(self, line: int, column: int, text: str) -> float:
        text = text.strip()
        if not text:
            return float("nan")
        value = _number(text)
        if value is None:
            self.report(line, column, text)
            return float("nan")
        return value


def _cell(cells: Sequence[str], column: int) -> str:
    return cells[column] if column < len(cells) else ""


def _number(text: str) -> float | None:
    if text.lower() == "nan":
        return float("nan")
    try:
        value = float(text)
    except ValueError:
        return None
    return value if np.isfinite(value) and "_" not in text else None


def _fill_empty(chunk: bytes, marks: IntArray) -> bytes:
    """Write nan into every empty cell, so that numpy reads it."""
    before = np.concatenate(([-1], marks[:-1]))
    empty = marks[marks - before == 1].tolist()
    pieces = [chunk[a:b] for a, b in zip([0, *empty], [*empty, len(chunk)], strict=True)]
    return b"nan".join(pieces)
