"""Copies of databases from before a migration: kept beside them, and put back when it is undone."""

import os
import sqlite3
from contextlib import closing, suppress
from pathlib import Path

from agent.storage.database.files import Lock, beside, created, make_alike, sync_folder

_COMPANIONS = ("-wal", "-shm", "-journal", ".lock")
"""What belongs to the rows of a file and to no copy of it; the lock knows of rows that the copy lacks."""


def copy_of(path: Path, version: str) -> Path:
    """Return where the copy from before a version lies."""
    return beside(path, f".before-{version}")


def aside_of(path: Path, version: str) -> Path:
    """Return where the file that a version wrote lies once the copy has taken its place."""
    return beside(path, f".of-{version}")


def copies_of(path: Path) -> list[Path]:
    """Return the copies from before that lie beside a database."""
    return sorted(path.parent.glob(f"{path.name}.before-*"))


def keep(path: Path, version: str) -> Path:
    """Copy a database that no agent writes to; return the copy. Copies from before other versions go.

    It appears under its name only when it is whole and on the disk.
    Raises StoreHeldError where an agent writes to it, sqlite3.Error and OSError where the disk refuses.
    """
    lock = Lock(path)
    try:
        former = copies_of(path)
        copy = copy_of(path, version)
        part = beside(copy, ".part")
        part.unlink(missing_ok=True)
        created(part).close()
        with closing(_opened(path)) as source, closing(sqlite3.connect(part)) as target:
            source.backup(target)
        make_alike(part, path)
        _sync(part)
        part.rename(copy)
        sync_folder(path.parent)
        for old in former:
            if old != copy:
                old.unlink()
    finally:
        lock.release()
    return copy


def restore(path: Path, version: str) -> Path:
    """Put the copy from before a version in the database's place; return where the version's file lies now.

    What belongs to that file goes first, so that a power cut on the way never leaves the copy beside
    another's log. Raises StoreHeldError where an agent writes to it, OSError where the disk refuses.
    """
    aside = aside_of(path, version)
    lock = Lock(path)
    try:
        for suffix in _COMPANIONS:
            with suppress(FileNotFoundError):
                beside(path, suffix).rename(beside(aside, suffix))
        aside.unlink(missing_ok=True)
        aside.hardlink_to(path)
        copy_of(path, version).rename(path)
        sync_folder(path.parent)
    finally:
        lock.release()
    return aside


def _opened(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
