"""Lines of serial text to samples: delimited cells, or what the groups of a pattern catch. Pure: no I/O."""

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from drivers.port import Counts, DriverConfigError, Trace
from drivers.serial.codec import Samples, SerialDecoder
from drivers.serial.tuning import LONGEST, SHOWN_LETTERS

_NUMBER = re.compile(r"[ \t]*(?:(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|nan|NaN|NAN)[ \t]*)?", re.ASCII)


class TextDecoder(SerialDecoder):
    """Lines of delimited text, or lines that a pattern with named groups matches whole.

    With checksum "nmea" a line is `$ADDRESS,cells*HH`: the address is passed over, HH is the exclusive or of
    what lies between $ and *. Rejects by "length", "checksum", "columns", "pattern" and "text" (a cell that
    is no number); an empty cell is a missing value. Without a checksum the piece of a line amid which the
    port was opened is passed over. The first line that is rejected for a reason is noted.
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
        note: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._note = note
        self._noted: set[str] = set()
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
        if len(rest) > LONGEST:
            self._counts.faults["stray bytes"] += len(rest)
            begin = ascii(rest[:40].decode("latin-1"))
            self._counts.first.setdefault("stray bytes", f"{begin}: no line feed within {LONGEST} characters")
            rest, self._begun = b"", False
        if lines and not self._begun:
            self._counts.faults["stray bytes"] += len(lines.pop(0))
            self._begun = True
        self._rest = rest
        read = [(line, row) for line in lines if line.strip() and (row := self._row(line)) is not None]
        rows = [row for _, row in read]
        table = np.array(rows).reshape(len(rows), len(self._columns))
        if self._counts.trace is not None:
            shown = [line.decode("latin-1").strip("\r\n \0") for line, _ in read[-Trace.NEWEST :]]
            self._counts.trace.good(shown, table[-Trace.NEWEST :, self._places])
        counter = None if self._counter is None else table[:, self._counter].astype(np.int64)
        return table[:, self._places], counter

    def _row(self, line: bytes) -> list[float] | None:
        """Return the numbers of a line, or None with the reason counted."""
        self._counts.received += 1
        text = line.decode("latin-1").strip("\r\n \0")
        row = self._cells(text)
        if isinstance(row, str):
            self._reject(row, text)
            return None
        return row

    def _reject(self, reason: str, text: str) -> None:
        self._counts.rejected[reason] += 1
        self._counts.show_bad(reason, f'"{text[:SHOWN_LETTERS]}": {self._why(reason, text)}')
        if reason not in self._noted:
            self._noted.add(reason)
            more = "..." if len(text) > SHOWN_LETTERS else ""
            self._note(f'rejected as "{reason}": {text[:SHOWN_LETTERS]!a}{more}: {self._why(reason, text)}')

    def _why(self, reason: str, text: str) -> str:
        """Say what a line that is rejected for a reason is not."""
        body = (_nmea_body(text) if self._nmea else text) or ""
        cells = len(body.split(self._delimiter)) - self._nmea
        behind = " behind its address, which with $ is no column" if self._nmea else ""
        sentence = self._sentence(text)
        between = ", held against what lies between $ and *, the address included" if self._nmea else ""
        return {
            "length": f"more than {LONGEST} characters",
            "checksum": (
                'checksum = "nmea" wants $ADDRESS,cells*HH, HH the exclusive or of what lies between $ and *'
            ),
            "columns": f"{cells} cells{behind}; columns has {len(self._columns)}{sentence}",
            "pattern": f"does not match the pattern{between}",
            "text": f"a cell is no decimal number{sentence}",
            "counter": "the counter is no whole number",
        }[reason]

    def _sentence(self, text: str) -> str:
        """Advise the key that lines which are NMEA sentences want where it is not set."""
        is_unexpected = not self._nmea and _nmea_body(text) is not None
        return '; of $ADDRESS,cells*HH take checksum = "nmea"' if is_unexpected else ""

    def _cells(self, line: str) -> list[float] | str:
        if len(line) > LONGEST:
            return "length"
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
    start = line.find("$")
    star = line.rfind("*")
    if start < 0 or not re.fullmatch("[0-9A-Fa-f]{2}", line[star + 1 :]) or star < start:
        return None
    body = line[start + 1 : star]
    check = 0
    for byte in body.encode("latin-1"):
        check ^= byte
    return body if check == int(line[star + 1 :], 16) else None


def _numbers(cells: Sequence[str | None], counter: int | None) -> list[float] | str:
    # float() takes more for numbers than an instrument writes: 1_000, foreign digits, infinity
    if not all(_NUMBER.fullmatch(cell) for cell in cells if cell):
        return "text"
    numbers = [float(cell) if cell and not cell.isspace() else math.nan for cell in cells]
    if any(math.isinf(number) for number in numbers):
        return "text"
    if counter is not None and not (numbers[counter].is_integer() and 0 <= numbers[counter] < 2**53):
        return "counter"
    return numbers
