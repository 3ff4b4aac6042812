"""The agent's own recordings as sources that end, for `deltak replay`."""

import logging
from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

from agent.config import RigConfig, driver_class
from agent.config.tables import Source
from agent.errors import Fault, RecordingError
from agent.recording import blocks, capture
from agent.recording.header import RawHeader
from drivers.port import Driver, DriverConfigError, DriverSettings, SampleBlock, SourceRequest

log = logging.getLogger(__name__)


class RawSettings(DriverSettings):
    """The files of a recording of one source, in order."""

    paths: tuple[Path, ...]


class OwnRecording(Driver):
    """Plays recordings of one source, file after file, as received; `read` raises EOFError at the end.

    Pickled between two blocks it goes on behind them, where the files are there too.

    Attributes:
        damaged: files that could not be read to their end, in words.
    """

    settings_model: ClassVar[type[DriverSettings]] = RawSettings
    finite: ClassVar[bool] = True
    _blocks: Iterator[SampleBlock] = iter(())
    _file = 0
    _read = 0
    """Deliveries that were read of the current file."""

    def __init__(self, request: SourceRequest) -> None:
        super().__init__(request)
        self.damaged: list[Fault] = []

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_blocks"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._blocks = self._rest()

    def open(self) -> None:
        """See that every file is a recording with the fields asked for."""
        for path in self.request.settings.paths:
            _places(path, _header(path), self.request.fields)
        self._file = self._read = 0
        self._blocks = self._rest()

    def _rest(self) -> Iterator[SampleBlock]:
        """Yield what is not read yet."""
        paths = self.request.settings.paths
        while self._file < len(paths):
            header = _header(paths[self._file])
            self.counter_modulus = header.counter_modulus
            for block in self.blocks(paths[self._file], header, self._read):
                self._read += 1
                if len(block):
                    yield block
            self._file += 1
            self._read = 0

    @abstractmethod
    def blocks(self, path: Path, header: RawHeader, skip: int) -> Iterator[SampleBlock]:
        """Yield what a file holds, behind so many deliveries."""

    def cut(self, path: Path, left: int) -> None:
        """Note that so many bytes at the end of a file cannot be read."""
        what = f"is cut short or damaged, its last {left} bytes cannot be read"
        self.damaged.append(Fault(str(path), what, "what stands before them is used; look for another copy"))

    def read(self, timeout_s: float) -> SampleBlock:
        """Return the next block."""
        block = next(self._blocks, None)
        if block is None:
            raise EOFError(f"{self.request.name}: end of the recording")
        return block

    def close(self) -> None:
        """Forget the files."""
        self._blocks = iter(())


class RawDriver(OwnRecording):
    """Plays samples that were recorded as samples."""

    def blocks(self, path: Path, header: RawHeader, skip: int) -> Iterator[SampleBlock]:
        columns = list(_places(path, header, self.request.fields))
        for block in islice(blocks.read_blocks(path, partial(self.cut, path)), skip, None):
            self.counts.received += len(block)
            yield replace(block, values=block.values[:, columns])

    def resolution(self) -> tuple[float, ...]:
        """Unknown: the configuration's source says."""
        return (0.0,) * len(self.request.fields)


class CaptureDriver(OwnRecording):
    """Plays what a bus carried: the source's own driver makes samples of it, as it did on the bus.

    Args:
        request: its settings say which files.
        line: the source's driver, never opened.
    """

    def __init__(self, request: SourceRequest, line: Driver) -> None:
        super().__init__(request)
        self._line = line
        self.counts = line.counts

    def blocks(self, path: Path, header: RawHeader, skip: int) -> Iterator[SampleBlock]:
        for piece in islice(capture.read_pieces(path, partial(self.cut, path)), skip, None):
            block = self._line.decode_capture(piece.text, piece.beside)
            yield replace(block, arrival_ns=piece.arrival_ns, wall_offset_ns=piece.wall_offset_ns)

    def resolution(self) -> tuple[float, ...]:
        return self._line.resolution()


def header_of(path: Path) -> RawHeader:
    """Read what one of the agent's own recordings says of itself. Raises RecordingError."""
    try:
        if path.suffix != blocks.SUFFIX:
            return capture.read_header(path)
        with path.open("rb") as file:
            return blocks.read_header(file, path)
    except OSError as error:
        what = f"cannot be read: {error.strerror or error}"
        raise RecordingError.at(path, what, "look at its permissions") from error


def _header(path: Path) -> RawHeader:
    """Read a recording's header as a driver does. Raises DriverConfigError."""
    try:
        return header_of(path)
    except RecordingError as error:
        raise DriverConfigError(str(error)) from error


def _places(path: Path, header: RawHeader, fields: tuple[str, ...]) -> tuple[int, ...]:
    missing = [name for name in fields if name not in header.fields]
    if missing:
        held = ", ".join(header.fields)
        raise DriverConfigError(f"{path}: has no field {', '.join(missing)}; fields are {held}")
    return tuple(header.fields.index(name) for name in fields)


def is_own(path: Path) -> bool:
    """Tell whether a file is one of the agent's own recordings."""
    return path.suffix == blocks.SUFFIX or capture.index_of(path).is_file()


def without_indexes(paths: Sequence[Path]) -> list[Path]:
    """Return the recordings among the files of a folder: an index belongs to the log of its name."""
    return [path for path in paths if path.suffix != capture.INDEX or not path.with_suffix("").is_file()]


def own_recordings(rig: RigConfig, paths: Sequence[Path]) -> dict[str, Driver]:
    """Return the drivers that play the agent's own recordings, by the name of the source; not open.

    Raises RecordingError for one of no source of the configuration, and for a source with none.
    """
    sources = (*rig.source, *rig.covariate_source)
    files: dict[str, list[Path]] = {}
    for path in paths:
        files.setdefault(source_of(rig, path).name, []).append(path.absolute())
    missing = [source.name for source in rig.source if source.name not in files]
    if missing:
        advice = "give the recordings of every source"
        raise RecordingError.at(
            "", f"{paths[0]}: the source {', '.join(missing)} is not in the recordings", advice
        )
    there = [source for source in sources if source.name in files]
    return {source.name: _driver(rig, source, files[source.name], source.fields) for source in there}


def own_recording(rig: RigConfig, path: Path) -> Driver:
    """Return the driver that plays one recording, its columns in the order of the rig's channels; not open.

    Raises RecordingError when no source with every channel was recorded there.
    """
    source = source_of(rig, path)
    channels = [channel.name for channel in (*rig.inputs, *rig.outputs)]
    missing = [name for name in channels if name not in source.map]
    if missing:
        raise RecordingError.at(
            "", f"{path}: {source.name} does not carry {', '.join(missing)}", "replay all sources"
        )
    return _driver(rig, source, [path.absolute()], tuple(source.map[name] for name in channels))


def source_of(rig: RigConfig, path: Path) -> Source:
    """Return the source of a recording: one whose fields it has, of the name it was recorded under if any."""
    header = header_of(path)
    sources = (*rig.source, *rig.covariate_source)
    able = [source for source in sources if set(source.fields) <= set(header.fields)]
    named = [source for source in able if source.name == header.source] or able
    if not named:
        advice = "replay it with the configuration it was recorded with"
        raise RecordingError.at(path, "no source of the configuration was recorded there", advice)
    if header.config_sha256 != rig.sha256:
        log.info("%s: was recorded with another configuration (%s)", path, header.config_sha256[:12])
    return named[0]


def _driver(rig: RigConfig, source: Source, paths: Sequence[Path], fields: tuple[str, ...]) -> Driver:
    """Return the driver that plays a source's recordings, all of one form. Raises RecordingError."""
    request = SourceRequest(source.name, RawSettings(paths=tuple(paths)), fields)
    if all(path.suffix == blocks.SUFFIX for path in paths):
        return RawDriver(request)
    if any(path.suffix == blocks.SUFFIX for path in paths):
        raise RecordingError.at(
            "", f"{paths[0]}: recordings of {source.name} have two forms", "replay each by itself"
        )
    own = SourceRequest(source.name, source.settings, fields, source.counter, rig.folder)
    return CaptureDriver(request, driver_class(source.driver)(own))
