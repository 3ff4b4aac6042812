"""Recordings as a source that ends: CSV tables and NPZ arrays, streamed in blocks with flat memory."""

import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from drivers.files.csv_file import CsvFile
from drivers.files.csv_text import NO_TIME
from drivers.files.npz_file import NpzFile
from drivers.files.resolution import grid_step
from drivers.files.table import RecordedFile, Rows, Wanted
from drivers.files.tuning import HELD, LEVELS
from drivers.port import Driver, DriverIOError, DriverSettings, FloatArray, IntArray, SampleBlock

TIME = "t"


class RecordingSettings(DriverSettings):
    """A recording and how its columns are called.

    Attributes:
        path: an .npz file, or a text table of any other name.
        delimiter: between the cells of a table; found among comma, semicolon and tab when not given.
        columns: field name -> column name in the recording, for those that differ ("t" may be renamed as
            well).
        optional: fields that the recording may be without; they are NaN then.
        clock: with "uniform" the time column may be missing and its unreadable cells do no harm.
    """

    path: Path
    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    columns: Mapping[str, str] = Field(default_factory=dict)
    optional: tuple[str, ...] = ()
    clock: Literal["device", "uniform"] = "device"


class RecordingDriver(Driver):
    """Plays a recording as fast as it is read; `read` raises EOFError at its end.

    An empty or unreadable cell is NaN, the latter counted in counts.faults["text"] and noted with its line; a
    row without a readable time is rejected ("time"), unless the clock is uniform.
    """

    settings_model: ClassVar[type[DriverSettings]] = RecordingSettings
    finite: ClassVar[bool] = True
    _file: RecordedFile | None = None
    _rows: Iterator[Rows] = iter(())
    _ahead: Rows | None = None
    _last_ns = 0

    def open(self) -> None:
        self.close()
        settings: RecordingSettings = self.request.settings
        wanted = Wanted(
            path=self.request.folder / settings.path,
            names=tuple(settings.columns.get(name, name) for name in self.request.fields),
            time=settings.columns.get(TIME, TIME),
            time_needed=settings.clock != "uniform",
            delimiter=settings.delimiter,
            note=self.note,
            fault=self._fault,
            optional=frozenset(settings.columns.get(name, name) for name in settings.optional),
        )
        self._file = NpzFile(wanted) if wanted.path.suffix.lower() == ".npz" else CsvFile(wanted)
        self._rows = _completed(self._file.rows(), [name in self._file.names for name in wanted.names])
        self._ahead = None

    def read(self, timeout_s: float) -> SampleBlock:
        if self._file is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        rows, self._ahead = self._ahead or next(self._rows, None), None
        if rows is None:
            raise EOFError(f"{self.request.settings.path}: end of the recording")
        return self._block(*rows)

    def close(self) -> None:
        if self._file is not None:
            self._file.close()
        self._file = None

    def resolution(self) -> tuple[float, ...]:
        """Return the step that all readings of the first block are whole numbers of; 0.0 where none is."""
        if self._file is not None and self._ahead is None:
            self._ahead = next(self._rows, None)
        if self._ahead is None:
            return (0.0,) * len(self.request.fields)
        return tuple(grid_step(column) for column in self._ahead[1].T)

    def switched(self) -> tuple[bool, ...]:
        """Tell of each field whether it is held at a few levels: the step between two is no resolution.

        Of the first block, before it is read, as `resolution` is; False where there is none.
        """
        if self._ahead is None:
            return (False,) * len(self.request.fields)
        return tuple(_is_switched(column) for column in self._ahead[1].T)

    def _fault(self, words: str) -> None:
        self.counts.faults["text"] += 1
        self.note(words)

    def _block(self, t_ns: IntArray | None, values: FloatArray) -> SampleBlock:
        self.counts.received += len(values)
        if t_ns is not None:
            t_ns, values = self._timed(t_ns, values)
        return SampleBlock(values, time.monotonic_ns(), None, t_ns)

    def _timed(self, t_ns: IntArray, values: FloatArray) -> tuple[IntArray, FloatArray]:
        bad = t_ns == NO_TIME
        if bad.any():
            if self.request.settings.clock == "uniform":
                t_ns = self._carried(t_ns, bad)
            else:
                self.counts.rejected["time"] += int(bad.sum())
                t_ns, values = t_ns[~bad], values[~bad]
        self._last_ns = int(t_ns[-1]) if len(t_ns) else self._last_ns
        return t_ns, values

    def _carried(self, t_ns: IntArray, bad: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> IntArray:
        """Return the times with the last readable one in place of those that are not."""
        newest = np.maximum.accumulate(np.where(bad, -1, np.arange(len(t_ns))))
        return np.where(newest < 0, self._last_ns, t_ns[np.maximum(newest, 0)])


def _completed(rows: Iterator[Rows], present: Sequence[bool]) -> Iterator[Rows]:
    """Yield rows with a column of NaN for each field that the recording has not."""
    places = np.flatnonzero(present)
    for t_ns, values in rows:
        whole = values
        if len(places) < len(present):
            whole = np.full((len(values), len(present)), np.nan)
            whole[:, places] = values
        yield t_ns, whole


def _is_switched(values: FloatArray) -> bool:
    """Tell if readings (n,) are those of something that is commanded in a few levels and stays at each."""
    finite = values[np.isfinite(values)]
    jumps = int(np.count_nonzero(np.diff(finite)))
    return HELD * jumps < len(finite) and len(np.unique(finite)) < LEVELS
