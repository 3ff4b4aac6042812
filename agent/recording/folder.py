"""The files of one recording: numbered, bounded by size and age, oldest first; and room left on the disk."""

import os
import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path

from agent.recording.ages import Ages
from agent.recording.tuning import LEAST_FREE
from agent.storage.database.files import sync_folder

AGES = ".ages"
"""Ending of the file that says how old the others are."""


def room(folder: Path) -> int:
    """Return how many bytes may be written before the disk is too full for recordings; negative if it is."""
    disk = os.statvfs(folder)
    size, free = disk.f_blocks * disk.f_frsize, disk.f_bavail * disk.f_frsize
    return free - min(LEAST_FREE, size // 10)


def make_folder(folder: Path) -> None:
    """See that a folder is there, and on the disk."""
    if not folder.is_dir():
        folder.mkdir(mode=0o750, parents=True, exist_ok=True)
        sync_folder(folder.parent)


@dataclass(slots=True)
class SegmentFolder:
    """The numbered files NAME-NNNNNNNN.SUFFIX of one recording, each with its companions, in one folder.

    Attributes:
        folder, name: where, and what they are called.
        suffixes: of the forms that a recording may have; the newest number counts over all of them.
        companions: suffixes added to a file's name for what belongs to it.
        max_bytes: of all together.
        max_age_s: since a file was complete, in time that agents ran.
    """

    folder: Path
    name: str
    suffixes: tuple[str, ...]
    companions: tuple[str, ...] = ()
    max_bytes: float = float("inf")
    max_age_s: float = float("inf")
    _ages: Ages = field(init=False)

    def __post_init__(self) -> None:
        self._ages = Ages(self.folder / f"{self.name}{AGES}")

    def files(self) -> list[Path]:
        """Return the files, oldest first."""
        pattern = re.compile(rf"{re.escape(self.name)}-(\d{{8}})({'|'.join(map(re.escape, self.suffixes))})")
        found = (
            [path for path in self.folder.iterdir() if pattern.fullmatch(path.name)]
            if self.folder.is_dir()
            else []
        )
        return sorted(found, key=lambda path: path.stem.rsplit("-", 1)[1])

    def next(self, suffix: str) -> Path:
        """Return the name of the file after the newest one; makes the folder."""
        make_folder(self.folder)
        there = self.files()
        number = int(there[-1].stem.rsplit("-", 1)[1]) + 1 if there else 0
        return self.folder / f"{self.name}-{number:08d}{suffix}"

    def size(self, path: Path) -> int:
        """Return the bytes of a file and its companions."""
        return sum(part.stat().st_size for part in self._parts(path) if part.exists())

    def end(self, path: Path) -> None:
        """Note that a file is complete, from now on."""
        if isfinite(self.max_age_s):
            self._ages.note(path.name)

    def prune(self, writing: Path | None = None) -> list[Path]:
        """Delete the oldest files until size and age are in bounds, never the current one; return them."""
        there = [path for path in self.files() if path != writing]
        total = sum(map(self.size, there)) + (self.size(writing) if writing is not None else 0)
        gone = []
        for path in there:
            if total > self.max_bytes or self._ages.of(path.name) > self.max_age_s:
                total -= self.size(path)
                self.delete([path])
                gone.append(path)
        if isfinite(self.max_age_s):
            self._ages.keep(path.name for path in there if path not in gone)
        return gone

    def delete(self, paths: Iterable[Path]) -> None:
        """Delete files and what belongs to them."""
        for path in paths:
            for part in self._parts(path):
                part.unlink(missing_ok=True)

    def _parts(self, path: Path) -> list[Path]:
        return [path, *(path.with_name(path.name + suffix) for suffix in self.companions)]
