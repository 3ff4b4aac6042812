"""CAN logs as a source that ends: candump text read here, .asc, .blf, .trc and .mf4 by python-can."""

import gzip
import itertools
from collections.abc import Callable, Generator, Iterable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from drivers.can.bus.bus import message_row
from drivers.can.codec.capture import interface_name
from drivers.can.codec.frames import Frames, frames_of
from drivers.can.codec.layout import FrameKeys
from drivers.can.codec.python_can import import_lean, import_measurements
from drivers.can.driver import DbcDriver
from drivers.can.log.interfaces import channel_of, shown, wire_of
from drivers.can.log.text import candump_block
from drivers.can.log.unmatched import UnmatchedFrames
from drivers.can.tuning import LOG_BYTES, LOG_FRAMES
from drivers.port import DriverConfigError, DriverIOError, DriverSettings, SampleBlock
from drivers.timestamps import seconds_to_ns

if TYPE_CHECKING:
    import can

SUFFIXES = (".log", ".asc", ".blf", ".trc", ".mf4")


class CanLogSettings(FrameKeys):
    """A log, the DBC file that describes its frames, and how samples lie in them.

    Attributes:
        interface, channel: what the source listens to; read alone where a log names it beside others.
    """

    path: Path
    interface: str = "socketcan"
    channel: str | None = None


class CanLogDriver(DbcDriver):
    """Plays a CAN log; `read` raises EOFError at its end. Times are the log's own, in ns.

    A log that cannot be read from its beginning raises DriverConfigError; one that is damaged further on ends
    there, which is noted and counted (faults "log"). Lines of text that are no frame are noted and counted
    (faults "text"). Of a log in which no frame is one of those looked for, what it holds is noted at its end.
    """

    settings_model: ClassVar[type[DriverSettings]] = CanLogSettings
    finite: ClassVar[bool] = True
    _frames: Iterator[Frames] | None = None
    _unmatched: UnmatchedFrames

    def open(self) -> None:
        self.prepare()
        self._decoder.restart()
        self._unmatched = UnmatchedFrames()
        path = self.request.folder / self.request.settings.path
        if _kind(path) not in SUFFIXES:
            raise DriverConfigError(f"{path}: is no CAN log that can be read; {', '.join(SUFFIXES)} are")
        reader = self._candump(path) if path.suffix.lower() == ".log" else self._library(path)
        first = next(reader, None)
        if first is None:
            raise DriverConfigError(f"{path}: holds no frame")
        self._frames = itertools.chain([first], reader)

    def read(self, timeout_s: float) -> SampleBlock:
        if self._frames is None:
            raise DriverIOError(f"{self.request.name}: read before open")
        frames = next(self._frames, None)
        if frames is None:
            rest = self._decoder.flush()
            if rest is None:
                self._end()
                raise EOFError(f"{self.request.settings.path}: end of the log")
            return self.block_of(rest)
        block = self.decoded(frames)
        if not self.counts.received:
            self._unmatched.see(frames.table)
        return block

    def _end(self) -> None:
        """Note what a log holds that has nothing of what is looked for, before all other remarks."""
        if not self.counts.received:
            words = (
                f"{self.request.folder / self.request.settings.path}: {self._unmatched.words(self._messages)}"
            )
            self._notes = [words, *(note for note in self._notes if note != words)]

    def close(self) -> None:
        self._frames = None

    def _candump(self, path: Path) -> Iterator[Frames]:
        try:
            with path.open("rb") as file:
                wire = self._wire(file, path)
                start = 1
                for text in _whole_lines(file):
                    frames, bad = candump_block(text, wire)
                    self._note_lines(path, start, bad)
                    start += text.count(b"\n")
                    if len(frames):
                        yield frames
        except OSError as error:
            raise DriverConfigError(f"{path}: {error.strerror or error}") from error

    def _wire(self, file: IO[bytes], path: Path) -> bytes | None:
        """Return the interface whose frames are read, None where all are; the file is at its start then."""
        channel: str | None = self.request.settings.channel
        if channel is None:
            return None
        try:
            return wire_of(_whole_lines(file), interface_name(channel))
        except DriverConfigError as error:
            raise DriverConfigError(f"{path}: {error}") from error
        finally:
            file.seek(0)

    def _note_lines(self, path: Path, start: int, bad: list[int]) -> None:
        self.counts.faults["text"] += len(bad)
        for place in bad[:20]:
            self.note(f"{path}:{start + place}: is no frame; it is passed over")

    def _library(self, path: Path) -> Iterator[Frames]:
        begun = False
        try:
            channel = self._channel(path)
            messages = _messages(path)
            for batch in _batches(messages):
                begun = True
                if kept := self._of_channel(batch, channel, path):
                    yield _packed(kept)
        except DriverConfigError as error:
            raise DriverConfigError(f"{path}: {error}") from error
        except ImportError as error:
            words = "needs a library that is not installed: pip install 'deltak[mf4]'"
            raise DriverConfigError(f"{path}: {words}") from error
        except FileNotFoundError as error:
            raise DriverConfigError(f"{path}: {error.strerror}") from error
        except Exception as error:
            if not begun:
                what = f"cannot be read as a CAN log: {error!r}"
                raise DriverConfigError(f"{path}: {what}; see that its suffix is that of its form") from error
            self.counts.faults["log"] += 1
            self.note(f"{path}: is damaged, its end is not read: {error!r}")

    def _channel(self, path: Path) -> str | None:
        """Return the channel whose frames are to be read, None where all are."""
        settings: CanLogSettings = self.request.settings
        if settings.channel is None:
            return None
        kind = _kind(path)
        wanted = interface_name(settings.channel)
        return channel_of(_channels(path, kind), wanted, settings.interface, kind)

    def _of_channel(self, batch: "list[can.Message]", channel: str | None, path: Path) -> "list[can.Message]":
        """Return the messages of a channel, and note that there are others."""
        if channel is None:
            return batch
        kind = _kind(path)
        kept = [message for message in batch if shown(message.channel, kind) == channel]
        if len(kept) < len(batch):
            wanted = self.request.settings.channel
            self.note(f"{path}: channel {channel} is read for {wanted}, frames of others are passed over")
        return kept


def _messages(path: Path) -> "Generator[can.Message]":
    # the library leaves the file open when it cannot read it: it is opened, and so closed, here
    with _open_file(path) as file, _reader(path)(file) as reader:
        yield from reader


def _batches(messages: "Iterable[can.Message]") -> "Iterator[list[can.Message]]":
    """Yield messages many at a time; those before damage come before its exception."""
    batch: list[can.Message] = []
    try:
        for message in messages:
            batch.append(message)
            if len(batch) == LOG_FRAMES:
                yield batch
                batch = []
    except Exception:
        if batch:
            yield batch
        raise
    if batch:
        yield batch


def _channels(path: Path, kind: str) -> Iterator[str]:
    """Yield each frame's channel, as far as a log can be read; damage is reported when it is read."""
    messages = _messages(path)
    some = False
    try:
        for message in messages:
            some = True
            yield shown(message.channel, kind)
    except Exception:
        if not some:
            raise
    finally:
        messages.close()


def _whole_lines(file: IO[bytes]) -> Iterator[bytes]:
    """Yield a file in pieces that end where a line ends; a line that never ends is cut."""
    rest = b""
    while block := file.read(LOG_BYTES):
        cut = block.rfind(b"\n") + 1
        if cut or len(rest) > LOG_BYTES:
            yield rest + block[:cut]
            rest = block[cut:]
        else:
            rest += block
    if rest:
        yield rest


def _packed(messages: "list[can.Message]") -> Frames:
    times = np.array([message.timestamp for message in messages])
    return frames_of([message_row(message) for message in messages], seconds_to_ns(times))


def _open_file(path: Path) -> IO[Any]:
    opener = gzip.open if path.suffix == ".gz" else open
    if _kind(path) in (".blf", ".mf4"):
        return cast("IO[Any]", opener(path, "rb"))
    return cast("IO[Any]", opener(path, "rt", encoding="utf-8", errors="replace"))


def _kind(path: Path) -> str:
    """Return the suffix that names the format, below the .gz of a compressed log."""
    kinds = path.suffixes[-2:-1] if path.suffix == ".gz" else [path.suffix]
    return kinds[0].lower() if kinds else ""


def _reader(path: Path) -> "Callable[[IO[Any]], can.io.generic.MessageReader]":
    import_lean()
    import can

    if _kind(path) == ".mf4":
        import_measurements()
    readers: dict[str, Any] = {
        ".asc": can.ASCReader,
        ".blf": can.BLFReader,
        ".log": can.CanutilsLogReader,
        ".mf4": can.MF4Reader,
        ".trc": can.TRCReader,
    }
    reader: Callable[[IO[Any]], can.io.generic.MessageReader] = readers[_kind(path)]
    return reader
