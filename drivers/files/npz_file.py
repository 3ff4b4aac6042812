"""A recording as numpy arrays in an .npz file: one array a column, read in step, a piece at a time."""

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack
from typing import IO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from drivers.files.table import RecordedFile, Rows, Wanted
from drivers.files.tuning import BLOCK_ROWS, LARGE_BYTES, LONGEST_ARRAY_HEADER, PACKED_WELL
from drivers.port import DriverConfigError, FloatArray
from drivers.timestamps import seconds_to_ns

_SUFFIX = ".npy"
_BESIDE = {"index", "counter", "meta"}
"""What an event record holds beside its readings."""
_DAMAGE = (ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error)
"""What zipfile and numpy raise for a damaged file; RuntimeError covers unknown compression and encryption."""


def _check_header(stream: IO[bytes], version: tuple[int, int]) -> None:
    """Raise ValueError for a description that is too long to be one, before it is read."""
    if version != (1, 0):
        length = int.from_bytes(stream.read(4), "little")
        if length > LONGEST_ARRAY_HEADER:
            raise ValueError(f"its array is described in {length} bytes")
        stream.seek(-4, 1)


class _Column:
    """One array of the file, read from its start to its end."""

    def __init__(self, stream: IO[bytes], path: str) -> None:
        self._stream = stream
        self._path = path
        try:
            version = npy.read_magic(stream)
            _check_header(stream, version)
            header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
            self.shape, _, self.dtype = header(stream)
        except _DAMAGE as error:
            raise DriverConfigError(f"{path}: is damaged: {error}") from error
        if self.dtype.kind not in "fiubM" or len(self.shape) != 1:
            raise DriverConfigError(
                f"{path}: is an array {self.shape} of {self.dtype}; a row of numbers is needed"
            )

    def take(self, count: int) -> NDArray[np.generic]:
        """Return the next `count` numbers; DriverConfigError when the file ends before."""
        try:
            data = self._stream.read(count * self.dtype.itemsize)
            return np.frombuffer(data, self.dtype, count)
        except _DAMAGE as error:
            raise DriverConfigError(f"{self._path}: is damaged: {error}") from error


class NpzFile(RecordedFile):
    """An .npz file; raises DriverConfigError when it cannot be read. Pickled objects are refused."""

    def __init__(self, wanted: Wanted) -> None:
        self._wanted = wanted
        self._stack = ExitStack()
        try:
            self._zip = self._stack.enter_context(zipfile.ZipFile(wanted.path))
            self._begin()
        except DriverConfigError:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise DriverConfigError(f"{wanted.path}: {error.strerror or error}") from error
        except _DAMAGE as error:
            self.close()
            raise DriverConfigError(f"{wanted.path}: is no NPZ file: {error}") from error

    def _begin(self) -> None:
        present = [name.removesuffix(_SUFFIX) for name in self._zip.namelist() if name.endswith(_SUFFIX)]
        self.names = self._wanted.found(present)
        for name in self.names:
            self._wanted.place(name, present)
        time = self._wanted.time_place(present)
        self._wanted.note_ignored([name for name in present if name not in _BESIDE or "meta" not in present])
        self._check_size()
        self._columns = [self._column(name) for name in self.names]
        self._time = None if time is None else self._column(self._wanted.time)
        lengths = {column.shape[0] for column in [*self._columns, self._time] if column is not None}
        if len(lengths) != 1:
            raise DriverConfigError(
                f"{self._wanted.path}: its arrays have different lengths: {sorted(lengths)}"
            )
        (self._length,) = lengths
        if not self._length:
            raise DriverConfigError(f"{self._wanted.path}: its arrays are empty")

    def _check_size(self) -> None:
        """Raise DriverConfigError for a file that unpacks to what no measurement packs so well."""
        sizes = self._zip.infolist()
        packed, whole = sum(one.compress_size for one in sizes), sum(one.file_size for one in sizes)
        if whole > LARGE_BYTES and whole > PACKED_WELL * packed:
            what = (
                f"{packed} bytes that unpack to {whole}, {whole // max(packed, 1)} times as many, "
                "are no measurement"
            )
            raise DriverConfigError(f"{self._wanted.path}: {what}; see where it comes from")

    def _column(self, name: str) -> _Column:
        stream = self._stack.enter_context(self._zip.open(name + _SUFFIX))
        return _Column(stream, f"{self._wanted.path}: {name}")

    def rows(self) -> Iterator[Rows]:
        for start in range(0, self._length, BLOCK_ROWS):
            count = min(BLOCK_ROWS, self._length - start)
            # column by column: whatever is done with few columns goes several times faster along them
            values = np.empty((len(self._columns), count)).T
            for place, column in enumerate(self._columns):
                values[:, place] = column.take(count)
            self._drop_infinite(values)
            yield (None if self._time is None else seconds_to_ns(self._time.take(count))), values

    def _drop_infinite(self, values: FloatArray) -> None:
        infinite = np.isinf(values)
        for row, place in np.argwhere(infinite) if infinite.any() else ():
            name = self.names[place]
            self._wanted.fault(f"{self._wanted.path}: {name}: an infinite value counts as missing")
            values[row, place] = np.nan

    def close(self) -> None:
        self._stack.close()
