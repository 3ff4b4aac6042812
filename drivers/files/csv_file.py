"""A recording as a table of text: finds delimiter and header, then reads whole lines in large pieces."""

import codecs
import csv
from collections.abc import Iterator
from typing import BinaryIO

from drivers.files.csv_text import Table
from drivers.files.table import RecordedFile, Rows, Wanted
from drivers.files.tuning import BLOCK_ROWS, CHUNK_BYTES, LONGEST_HEADER, LONGEST_ROW
from drivers.port import DriverConfigError

_DELIMITERS = ",;\t"


class CsvFile(RecordedFile):
    """A text table with a header; raises DriverConfigError when the file cannot be one."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        try:
            self._file: BinaryIO = wanted.path.open("rb")
        except OSError as error:
            raise DriverConfigError(f"{wanted.path}: {error.strerror or error}") from error
        try:
            self._begin()
        except DriverConfigError:
            self.close()
            raise

    def _begin(self) -> None:
        header = self._header(self._file.readline(LONGEST_HEADER))
        delimiter = self._wanted.delimiter or max(_DELIMITERS, key=header.count)
        self._names = [name.strip() for name in next(csv.reader([header], delimiter=delimiter))]
        self._check_names()
        self.names = self._wanted.found(self._names)
        columns = tuple(self._wanted.place(name, self._names) for name in self.names)
        time = self._wanted.time_place(self._names)
        self._wanted.note_ignored(self._names)
        self._line = 2
        self._table = Table(delimiter, len(self._names), time, columns, self._report)
        self._first = self._rest_of_row(2)
        if not self._first.strip():
            raise DriverConfigError(f"{self._wanted.path}: has a header and no rows")

    def _header(self, line: bytes) -> str:
        if not line:
            raise DriverConfigError(f"{self._wanted.path}: is empty")
        try:
            text = line.decode("utf-8-sig").rstrip("\r\n")
        except UnicodeDecodeError:
            self._refuse_encoding(line)
            text = "\0"
        if "\r" in text and _is_text(text.replace("\r", "")):
            what = "has lines that end in a carriage return alone"
            raise DriverConfigError(f"{self._wanted.path}:1: {what}; save it with line feeds")
        if not _is_text(text):
            kinds = (
                "a CSV or NPZ file, or a CAN log (.log, .asc, .blf, .trc, .mf4); unpack what is compressed"
            )
            raise DriverConfigError(f"{self._wanted.path}:1: is not text; a recording is {kinds}")
        if len(line) == LONGEST_HEADER:
            what = f"a first line of more than {LONGEST_HEADER} bytes is not read"
            raise DriverConfigError(f"{self._wanted.path}:1: {what}; leave out columns that no channel needs")
        if not text.strip():
            raise DriverConfigError(f"{self._wanted.path}:1: is blank; the first line must name the columns")
        return text

    def _refuse_encoding(self, line: bytes) -> None:
        """Raise DriverConfigError for text of another encoding, as spreadsheets write it."""
        is_wide = line.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
        has_columns = any(delimiter.encode() in line for delimiter in _DELIMITERS)
        if is_wide or (has_columns and _is_text(line.decode("latin-1").rstrip("\r\n"))):
            wrong = f"{self._wanted.path}:1: is text, but not of UTF-8"
            kind = "UTF-16" if is_wide else "WINDOWS-1252"
            raise DriverConfigError(f"{wrong}; convert it: iconv -f {kind} -t UTF-8 OLD.csv > NEW.csv")

    def _check_names(self) -> None:
        if all(_is_number(name) for name in self._names):
            raise DriverConfigError(
                f"{self._wanted.path}:1: holds numbers and no names; the first line must name the columns"
            )

    def _report(self, line: int, column: int, text: str) -> None:
        place = f"{self._wanted.path}:{self._line + line}"
        self._wanted.fault(
            f'{place}: {self._names[column]}: "{text[:40]}" is no number; it counts as missing'
        )

    def rows(self) -> Iterator[Rows]:
        size = min(len(self._first) * BLOCK_ROWS, CHUNK_BYTES)
        chunk = self._first + self._chunk(size, self._line + 1)
        while chunk:
            yield self._table.read(chunk)
            self._line += chunk.count(b"\n")
            chunk = self._chunk(size, self._line)

    def _chunk(self, size: int, line: int) -> bytes:
        """Return some bytes, the first of which begin a line, and what completes the last row of them."""
        chunk = self._file.read(size)
        return chunk + self._rest_of_row(line + chunk.count(b"\n")) if chunk else chunk

    def _rest_of_row(self, line: int) -> bytes:
        """Return the bytes up to the end of a row; DriverConfigError for a row that is none."""
        rest = self._file.readline(LONGEST_ROW)
        if len(rest) == LONGEST_ROW and not rest.endswith(b"\n"):
            what = f"a row of more than {LONGEST_ROW} characters is none"
            raise DriverConfigError(f"{self._wanted.path}:{line}: {what}; see what the file holds there")
        return rest

    def close(self) -> None:
        self._file.close()


def _is_text(line: str) -> bool:
    return all(ord(character) >= 32 or character == "\t" for character in line)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
