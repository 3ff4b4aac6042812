r"""Raw recordings: everything a source delivered, as it was delivered, with the time of its receipt.

A recording is a folder of segments "SOURCE-NNNNNNNN.raw". A segment is

    "DELTAKRAW1\n"  magic and version
    u32, JSON       length and header: source, fields, counter_modulus, config_sha256, code_version, byte_order, created
    blocks          u32 length of what follows, u32 its CRC-32, then
                    i64 arrival_ns (monotonic), i64 wall_offset_ns (wall minus monotonic), u32 epoch, u32 rows,
                    u16 columns, u16 flags (1: counter, 2: t_ns, 4: wall_offset_ns is known),
                    rows x columns float64 row by row, rows int64 counter, rows int64 t_ns

Everything is little-endian. A segment cut short (power, full disk) is read up to its last whole block.
"""

import json
import os
import struct
import threading
import time
import zlib
from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from agent.errors import RecordingError
from drivers.port import SampleBlock

MAGIC = b"DELTAKRAW1\n"
_HEAD = struct.Struct("<qqIIHH")
_FRAME = struct.Struct("<II")
_LONGEST_BLOCK = 1 << 30
_COUNTER, _TIMES, _OFFSET = 1, 2, 4


@dataclass(frozen=True, slots=True)
class RawHeader:
    """What a segment says of itself; created_ns is wall time and only labels."""

    source: str
    fields: tuple[str, ...]
    counter_modulus: int | None
    config_sha256: str
    code_version: str
    created_ns: int
    byte_order: str = "little"


def encode_block(block: SampleBlock) -> bytes:
    """Return a block as it stands in a segment."""
    values = np.ascontiguousarray(block.values, dtype="<f8")
    parts = [values.tobytes()]
    flags = 0 if block.wall_offset_ns is None else _OFFSET
    for flag, numbers in ((_COUNTER, block.counter), (_TIMES, block.t_ns)):
        if numbers is not None:
            flags |= flag
            parts.append(np.ascontiguousarray(numbers, dtype="<i8").tobytes())
    rows, columns = values.shape
    head = _HEAD.pack(block.arrival_ns, block.wall_offset_ns or 0, block.epoch, rows, columns, flags)
    content = head + b"".join(parts)
    return _FRAME.pack(len(content), zlib.crc32(content)) + content


def decode_block(content: bytes) -> SampleBlock:
    """Return the block of a frame's content; raises ValueError when its sizes do not fit."""
    arrival, offset, epoch, rows, columns, flags = _HEAD.unpack_from(content)
    values = np.frombuffer(content, "<f8", rows * columns, _HEAD.size).reshape(rows, columns)
    place = _HEAD.size + 8 * rows * columns
    found: dict[int, np.ndarray[tuple[int], np.dtype[np.int64]] | None] = {_COUNTER: None, _TIMES: None}
    for flag in found:
        if flags & flag:
            found[flag] = np.frombuffer(content, "<i8", rows, place)
            place += 8 * rows
    if place != len(content):
        raise ValueError("the block's length is wrong")
    known = offset if flags & _OFFSET else None
    return SampleBlock(values, arrival, found[_COUNTER], found[_TIMES], epoch, known)


def read_header(file: BinaryIO, path: Path) -> RawHeader:
    """Read a segment's header. Raises RecordingError when it is none."""
    if file.read(len(MAGIC)) != MAGIC:
        raise RecordingError.at(str(path), "is not a raw recording of this version", "give a .raw file of the agent")
    try:
        (length,) = struct.unpack("<I", file.read(4))
        facts = json.loads(file.read(min(length, 1 << 20)))
        return RawHeader(**{**facts, "fields": tuple(facts["fields"])})
    except (ValueError, TypeError, KeyError, struct.error) as error:
        raise RecordingError.at(str(path), "its header is damaged", "use another segment") from error


def read_blocks(path: Path | str) -> Iterator[SampleBlock]:
    """Yield the blocks of a segment up to the first that is cut short or damaged."""
    path = Path(path)
    with path.open("rb") as file:
        read_header(file, path)
        while len(frame := file.read(_FRAME.size)) == _FRAME.size:
            length, crc = _FRAME.unpack(frame)
            if not _HEAD.size <= length <= _LONGEST_BLOCK:
                return
            content = file.read(length)
            if len(content) < length or zlib.crc32(content) != crc:
                return
            yield decode_block(content)


def segments(folder: Path | str, source: str) -> list[Path]:
    """Return the segments of a source, oldest first."""
    return sorted(Path(folder).glob(f"{source}-[0-9]*.raw"))


class Recorder:
    """Records one source in a thread of its own: `record` never blocks, a failing disk costs blocks, which are counted.

    Args:
        folder: made if missing.
        header: what each segment says of itself.
        max_bytes: of all segments of the source together; the oldest go first.
        max_age_s: segments that ended longer ago, by the monotonic clock of this process, go as well.
        segment_bytes: a new segment begins at this size.
        most_blocks: blocks that wait for the disk at most.
    """

    def __init__(
        self,
        folder: Path,
        header: RawHeader,
        *,
        max_bytes: int = 1 << 30,
        max_age_s: float = float("inf"),
        segment_bytes: int = 16 << 20,
        most_blocks: int = 4096,
    ) -> None:
        self._folder, self._header = folder, header
        self._max_bytes, self._max_age, self._segment_bytes, self._most = (
            max_bytes,
            max_age_s,
            segment_bytes,
            most_blocks,
        )
        self._queue: deque[SampleBlock] = deque()
        self._condition = threading.Condition()
        self._stopping = False
        self._file: BinaryIO | None = None
        self._ended: dict[Path, float] = {}
        self._thread = threading.Thread(target=self._work, name=f"recorder-{header.source}", daemon=True)
        self.progress = 0
        self.recorded = 0
        """Sample instants written."""
        self.dropped = 0
        """Sample instants that the disk was too slow or too full for."""

    def start(self) -> None:
        self._thread.start()

    def record(self, block: SampleBlock) -> None:
        """Hand over a block; what does not fit is counted as dropped."""
        with self._condition:
            if len(self._queue) >= self._most:
                self.dropped += len(block)
                return
            self._queue.append(block)
            self._condition.notify()

    def stop(self, timeout_s: float = 10.0) -> None:
        """Write what waits, sync and end the thread."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        self._thread.join(timeout_s)

    def _work(self) -> None:
        over = False
        while not over:
            with self._condition:
                self._condition.wait_for(lambda: self._queue or self._stopping, 1.0)
                blocks, over = list(self._queue), self._stopping
                self._queue.clear()
            self.progress += 1
            self._write(blocks)
        self._close()

    def _write(self, blocks: list[SampleBlock]) -> None:
        """Append blocks and sync; after a failure the next ones go to a new segment."""
        waiting = sum(map(len, blocks))
        try:
            for block in blocks:
                self._segment().write(encode_block(block))
            if self._file is not None:
                self._file.flush()
                os.fdatasync(self._file.fileno())
            self.recorded += waiting
        except OSError:
            self.dropped += waiting
            self._abandon()
        self._prune()

    def _segment(self) -> BinaryIO:
        """Return the open segment; a new one when there is none or it is full."""
        if self._file is not None and self._file.tell() >= self._segment_bytes:
            self._close()
        if self._file is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            there = segments(self._folder, self._header.source)
            number = int(there[-1].stem.rsplit("-", 1)[1]) + 1 if there else 0
            self._file = (self._folder / f"{self._header.source}-{number:08d}.raw").open("xb")
            facts = json.dumps(asdict(self._header)).encode()
            self._file.write(MAGIC + struct.pack("<I", len(facts)) + facts)
        return self._file

    def _close(self) -> None:
        if self._file is not None:
            self._ended[Path(self._file.name)] = time.monotonic()
            self._file.close()
            self._file = None

    def _abandon(self) -> None:
        """Leave a segment that cannot be written; closing it may fail as well."""
        try:
            self._close()
        except OSError:
            self._file = None

    def _prune(self) -> None:
        """Delete the oldest segments until size and age are within bounds; never the open one."""
        own = Path(self._file.name) if self._file is not None else None
        there = [path for path in segments(self._folder, self._header.source) if path != own]
        total = sum(path.stat().st_size for path in there) + (self._file.tell() if self._file is not None else 0)
        for path in there:
            old = time.monotonic() - self._ended.setdefault(path, time.monotonic()) > self._max_age
            if total > self._max_bytes or old:
                total -= path.stat().st_size
                path.unlink(missing_ok=True)
                self._ended.pop(path, None)
