r"""Samples as delivered: the form of sources whose bus has no form of recording that other tools read.

A file "NAME-NNNNNNNN.raw" is

    "DELTAKRAW1\n"  magic and version
    u32, JSON       length and header: source, fields, counter_modulus, config_sha256, code_version,
                    byte_order, created_ns, rig
    blocks          u32 length of what follows, u32 its CRC-32, then
                    i64 arrival_ns (monotonic), i64 wall_offset_ns (wall minus monotonic),
                    u32 epoch, u32 rows, u16 columns,
                    u16 flags (1: counter, 2: t_ns, 4: wall_offset_ns is known, 8: received_ns),
                    rows x columns float64 row by row,
                    rows int64 counter, rows int64 t_ns, rows int64 received_ns

Everything is little-endian. A file cut short (power, full disk) is read up to its last whole block.
"""

import json
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import BinaryIO

import numpy as np

from agent.errors import RecordingError
from agent.recording.header import RawHeader
from agent.storage.database.files import created
from drivers.port import Capture, SampleBlock

MAGIC = b"DELTAKRAW1\n"
SUFFIX = ".raw"
_HEAD = struct.Struct("<qqIIHH")
_FRAME = struct.Struct("<II")
_LONGEST_BLOCK = 1 << 30
_COUNTER, _TIMES, _OFFSET, _RECEIVED = 1, 2, 4, 8
"""Fixed by this file's format: bytes of a block that is no damage, and flags of what it holds."""


def encode_header(header: RawHeader) -> bytes:
    """Return what a file begins with."""
    facts = json.dumps(asdict(header)).encode()
    return MAGIC + struct.pack("<I", len(facts)) + facts


def encode_block(block: SampleBlock) -> bytes:
    """Return a block as it stands in a file."""
    values = np.ascontiguousarray(block.values, dtype="<f8")
    parts = [values.tobytes()]
    flags = 0 if block.wall_offset_ns is None else _OFFSET
    for flag, numbers in ((_COUNTER, block.counter), (_TIMES, block.t_ns), (_RECEIVED, block.received_ns)):
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
    found: dict[int, np.ndarray[tuple[int], np.dtype[np.int64]] | None] = dict.fromkeys(
        (_COUNTER, _TIMES, _RECEIVED)
    )
    for flag in found:
        if flags & flag:
            found[flag] = np.frombuffer(content, "<i8", rows, place)
            place += 8 * rows
    if place != len(content):
        raise ValueError("the block's length is wrong")
    known = offset if flags & _OFFSET else None
    return SampleBlock(values, arrival, found[_COUNTER], found[_TIMES], epoch, known, found[_RECEIVED])


def read_header(file: BinaryIO, path: Path) -> RawHeader:
    """Read a file's header. Raises RecordingError when it is none."""
    if file.read(len(MAGIC)) != MAGIC:
        raise RecordingError.at(
            path, "is not a raw recording of this version", "give a .raw file of the agent"
        )
    try:
        (length,) = struct.unpack("<I", file.read(4))
        return RawHeader.of(json.loads(file.read(min(length, 1 << 20))))
    except (ValueError, TypeError, KeyError, struct.error) as error:
        raise RecordingError.at(path, "its header is damaged", "use another segment") from error


def read_blocks(path: Path | str, cut: Callable[[int], object] = lambda _left: None) -> Iterator[SampleBlock]:
    """Yield the blocks of a file up to the first that is not whole; cut is called with the bytes left."""
    path = Path(path)
    with path.open("rb") as file:
        read_header(file, path)
        size = path.stat().st_size
        whole = file.tell()
        while (content := _content(file)) is not None:
            whole = file.tell()
            yield decode_block(content)
        if whole < size:
            cut(size - whole)


def _content(file: BinaryIO) -> bytes | None:
    """Read what the next frame holds; None where it is not whole."""
    frame = file.read(_FRAME.size)
    if len(frame) < _FRAME.size:
        return None
    length, crc = _FRAME.unpack(frame)
    if not _HEAD.size <= length <= _LONGEST_BLOCK:
        return None
    content = file.read(length)
    return content if len(content) == length and zlib.crc32(content) == crc else None


class BlockSegment:
    """One file of blocks while it is written."""

    def __init__(self, path: Path, header: RawHeader) -> None:
        self.path = path
        self._file = created(path)
        self._file.write(encode_header(header))

    def add(self, block: SampleBlock, capture: Capture | None) -> None:
        """Append a block of samples."""
        if len(block):
            self._file.write(encode_block(block))

    def size(self) -> int:
        return self._file.tell()

    def sync(self) -> None:
        self._file.flush()
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        self._file.close()
