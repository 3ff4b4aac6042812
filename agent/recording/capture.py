"""What a bus carried, in a form that other tools read, and beside it an index of when it was received.

A recording "NAME-NNNNNNNN.log" of CAN is what `candump -L` writes, and nothing else, so that canplayer,
log2asc, python-can and whatever reads such logs read it. What the text cannot carry stands in
"NAME-NNNNNNNN.log.idx", lines of JSON in UTF-8: first the header, with {"format": "DELTAKHEARD1"}, then a
line for each piece that one read delivered:

    lines, crc        how many lines of the log it is, and the CRC-32 of their bytes
    arrival_ns        monotonic time when it was received
    wall_offset_ns    wall minus monotonic clock then
    beside            what the driver adds (drivers/can/codec/capture.py): what of the time stamps is finer
                      than a microsecond, frames lost before they could be read, that the bus was opened anew

With the index a replay gives the rows of the live run; without it the log is one like any other.
"""

import json
import os
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from agent.errors import RecordingError
from agent.recording.header import RawHeader
from agent.storage.database.files import created
from drivers.port import Capture, SampleBlock

FORMAT = "DELTAKHEARD1"
INDEX = ".idx"


class Piece(NamedTuple):
    """What one read delivered, as it was recorded."""

    text: bytes
    arrival_ns: int
    wall_offset_ns: int | None
    beside: dict[str, Any]


def index_of(path: Path) -> Path:
    """Return where the index of a recording lies."""
    return path.with_name(path.name + INDEX)


def read_header(path: Path) -> RawHeader:
    """Read what a recording's index says of it. Raises RecordingError when it is none of this version."""
    try:
        with index_of(path).open(encoding="utf-8") as file:
            facts = json.loads(file.readline(1 << 20))
        if facts.pop("format") != FORMAT:
            raise ValueError
        return RawHeader.of(facts)
    except OSError as error:
        raise RecordingError.at(
            str(index_of(path)), error.strerror or str(error), "look at its permissions"
        ) from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        advice = "remove it to replay the log as any other"
        raise RecordingError.at(str(index_of(path)), "is no index of this version", advice) from error


def read_pieces(path: Path, cut: Callable[[int], object] = lambda _left: None) -> Iterator[Piece]:
    """Yield the pieces of a recording up to the first that is not whole; cut is called with the rest."""
    whole = 0
    with path.open("rb") as log, index_of(path).open("rb") as index:
        index.readline()
        for line in index:
            piece = _piece(line, log)
            if piece is None:
                break
            whole += len(piece.text)
            yield piece
    left = path.stat().st_size - whole
    if left > 0:
        cut(left)


def _piece(line: bytes, log: BinaryIO) -> Piece | None:
    """Return what a line of the index says of the next lines of the log; None where they do not fit."""
    try:
        facts = json.loads(line)
        text = b"".join(islice(log, facts["lines"]))
        if zlib.crc32(text) != facts["crc"]:
            return None
        return Piece(text, facts["arrival_ns"], facts["wall_offset_ns"], facts.get("beside", {}))
    except (ValueError, TypeError, KeyError, AttributeError):
        return None


class CaptureSegment:
    """A log and its index while they are written."""

    def __init__(self, path: Path, header: RawHeader) -> None:
        self.path = path
        self._log = created(path)
        try:
            self._index = created(index_of(path))
        except OSError:
            self._log.close()
            raise
        self._line({"format": FORMAT, **asdict(header)})

    def _line(self, facts: dict[str, Any]) -> None:
        self._index.write(json.dumps(facts, separators=(",", ":")).encode() + b"\n")

    def add(self, block: SampleBlock, capture: Capture | None) -> None:
        """Append what was captured; the block says when."""
        if capture is None:
            return
        text = capture.text()
        self._log.write(text)
        facts = {"lines": capture.lines, "crc": zlib.crc32(text)}
        times = {"arrival_ns": block.arrival_ns, "wall_offset_ns": block.wall_offset_ns}
        self._line(facts | times | ({"beside": dict(capture.beside)} if capture.beside else {}))

    def size(self) -> int:
        return self._log.tell() + self._index.tell()

    def sync(self) -> None:
        """Bring the log to the disk before its index: what the index names is there."""
        for file in (self._log, self._index):
            file.flush()
            os.fdatasync(file.fileno())

    def close(self) -> None:
        try:
            self._log.close()
        finally:
            self._index.close()
