"""The agent's own raw recordings as a source that ends, for `deltak replay`."""

from collections.abc import Iterator
from pathlib import Path
from typing import ClassVar

from agent.errors import RecordingError
from agent.runtime.recorder import read_blocks, read_header
from agent.runtime.sources import part
from drivers.port import Driver, DriverConfigError, DriverSettings, SampleBlock, SourceRequest

SUFFIX = ".raw"


class RawSettings(DriverSettings):
    """One segment of a recording."""

    path: Path


class RawDriver(Driver):
    """Plays a segment block by block as it was received; `read` raises EOFError at its end."""

    settings_model: ClassVar[type[DriverSettings]] = RawSettings
    finite: ClassVar[bool] = True
    _blocks: Iterator[SampleBlock] = iter(())
    _columns: tuple[int, ...] = ()

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self._path: Path = request.settings.path

    def open(self) -> None:
        """Read the segment's header and find the fields asked for."""
        try:
            with self._path.open("rb") as file:
                header = read_header(file, self._path)
        except RecordingError as error:
            raise DriverConfigError(str(error)) from error
        except OSError as error:
            raise DriverConfigError(f"{self._path}: {error.strerror or error}") from error
        lacking = [name for name in self.request.fields if name not in header.fields]
        if lacking:
            held = ", ".join(header.fields)
            raise DriverConfigError(f"{self._path}: has no field {', '.join(lacking)}; fields are {held}")
        self._columns = tuple(header.fields.index(name) for name in self.request.fields)
        self.counter_modulus = header.counter_modulus
        self._blocks = read_blocks(self._path)

    def read(self, timeout_s: float) -> SampleBlock:
        """Return the next block."""
        block = next(self._blocks, None)
        if block is None:
            raise EOFError(f"{self._path}: end of the segment")
        self.counts.received += len(block)
        return part(block, self._columns)

    def close(self) -> None:
        """Forget the segment."""
        self._blocks = iter(())

    def resolution(self) -> tuple[float, ...]:
        """Unknown: the configuration's source says."""
        return (0.0,) * len(self.request.fields)
