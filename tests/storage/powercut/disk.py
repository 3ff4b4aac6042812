"""A disk made of a log of operations: what of it is left when the power goes at any moment.

What was synced stays. Of what was not, any part may be there: nothing, a prefix, any subset, in any order,
writes torn at multiples of 512 bytes. Names (created, renamed, deleted) are there up to some point after the
folder's last sync. After a sync that failed nothing of what it was to write ever arrives, though processes
still read it, as on Linux.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

SECTOR = 512


@dataclass(frozen=True)
class Operation:
    kind: str
    file: int
    offset: int
    content: bytes


def read_log(path: Path, begin: int = 0) -> list[Operation]:
    """Return the operations that oplog.c recorded, from an offset on."""
    octets = path.read_bytes()[begin:]
    operations, place = [], 0
    while place < len(octets):
        kind, number, offset, length = struct.unpack_from("<cIQQ", octets, place)
        place += 21
        operations.append(Operation(kind.decode(), number, offset, octets[place : place + length]))
        place += length
    return operations


@dataclass
class File:
    synced: bytearray = field(default_factory=bytearray)
    pending: list[Operation] = field(default_factory=list)


@dataclass
class Disk:
    """The state of the disk after some of the operations."""

    files: dict[int, File] = field(default_factory=dict)
    names: dict[str, int] = field(default_factory=dict)
    pending_names: list[Operation] = field(default_factory=list)
    acknowledged: bytearray = field(default_factory=bytearray)

    def apply(self, operation: Operation) -> None:
        kind = operation.kind
        if kind in "WT":
            self.files[operation.file].pending.append(operation)
        elif kind == "S":
            file = self.files[operation.file]
            for write in file.pending:
                _write(file.synced, write)
            file.pending.clear()
        elif (
            kind == "F"
        ):  # what a failed sync was to write is clean in the cache from then on, and nowhere else
            file = self.files[operation.file]
            file.pending = [change for change in file.pending if change.kind == "T"]
        elif kind in "OUR":
            if kind == "O":
                self.files[operation.file] = File()
            self.pending_names.append(operation)
        elif kind == "D":
            for change in self.pending_names:
                _rename(self.names, change)
            self.pending_names.clear()
        elif kind == "A":
            self.acknowledged += operation.content

    def cut(self, rng: np.random.Generator) -> dict[str, bytes]:
        """Return the content of every named file after the power went."""
        names = dict(self.names)
        for change in self.pending_names[: rng.integers(len(self.pending_names) + 1)]:
            _rename(names, change)
        return {name: self._left(self.files[number], rng) for name, number in names.items()}

    def _left(self, file: File, rng: np.random.Generator) -> bytes:
        content = bytearray(file.synced)
        pending, mode = list(file.pending), rng.integers(4)
        if mode == 0:
            pending = []
        elif mode == 1:
            pending = pending[: rng.integers(len(pending) + 1)]
        else:
            pending = [write for write in pending if rng.integers(2)]
            rng.shuffle(pending)  # type: ignore[arg-type]
        for write in pending:
            _write(content, _torn(write, rng) if mode == 3 else write)
        return bytes(content)


def _write(content: bytearray, operation: Operation) -> None:
    if operation.kind == "T":
        del content[operation.offset :]
        content.extend(bytes(operation.offset - len(content)))
        return
    end = operation.offset + len(operation.content)
    content.extend(bytes(max(0, end - len(content))))
    content[operation.offset : end] = operation.content


def _torn(operation: Operation, rng: np.random.Generator) -> Operation:
    """Return a write of which only some sectors arrived; the first that did decides where it begins."""
    if operation.kind != "W" or len(operation.content) <= SECTOR:
        return operation
    sectors = -(-len(operation.content) // SECTOR)
    first, last = sorted(int(n) for n in rng.integers(0, sectors + 1, 2))
    content = operation.content[first * SECTOR : last * SECTOR]
    return Operation("W", operation.file, operation.offset + first * SECTOR, content)


def _rename(names: dict[str, int], change: Operation) -> None:
    text = change.content.decode()
    if change.kind == "O":
        names[text] = change.file
    elif change.kind == "U":
        names.pop(text, None)
    else:
        old, new = text.split("\0")
        if old in names:
            names[new] = names.pop(old)


def cuts(
    operations: list[Operation], count: int, rng: np.random.Generator
) -> Iterator[tuple[int, dict[str, bytes], bytes]]:
    """Yield (operation, files, what was acknowledged) for random moments, in order of time."""
    disk, done = Disk(), 0
    for moment in sorted(int(n) for n in rng.integers(0, len(operations) + 1, count)):
        while done < moment:
            disk.apply(operations[done])
            done += 1
        yield moment, disk.cut(rng), bytes(disk.acknowledged)
