"""How far rows were acknowledged, noted in DB.lock after each commit: tells a log that lost its end from a short one.

SQLite takes a write-ahead log up to its first wrong frame, so a flipped bit or a cut in it silently takes away what
came after. The note is not synced: it may be older than the truth after a power cut, never newer.
"""

import os
import sqlite3
import zlib
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path

from agent.storage.files import beside
from agent.storage.rows import Row

_PLACE = 64  # after the lock's signature, in the same sector
_TABLES = {"hops": "instants", "alarm_events": "steps of alarms", "health": "ledger rows", "events": "events"}


class Receipts:
    """The highest numbers that were acknowledged, by table.

    Args:
        handle: descriptor of the lock file.
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self.highs = _parsed(os.pread(handle, 256, _PLACE))

    def note(self, rows: Mapping[str, list[Row]]) -> None:
        """Note rows that are on the disk now; without a place for the note things go on without it."""
        news = {table: rows[table][-1][0] for table in _TABLES if rows.get(table)}
        if news:
            self._write({table: max(self.highs.get(table, 0), high) for table, high in (self.highs | news).items()})

    def forget(self) -> None:
        """Begin anew, with a new file."""
        if self.highs:
            self._write({})

    def missing(self, path: Path) -> str | None:
        """Return in words what was acknowledged and neither the database nor its side file holds; None when nothing.

        Reads only, so that a log whose end is damaged stays as it is.
        """
        if not self.highs or not path.exists():
            return None
        found = [_highs(file) for file in (path, beside(path, ".spill")) if file.exists()]
        lacking = {
            table: high - max((f.get(table, high) for f in found), default=high) for table, high in self.highs.items()
        }
        words = [f"{count} {_TABLES[table]}" for table, count in lacking.items() if count > 0]
        return f"{', '.join(words)} that were acknowledged are missing" if words else None

    def _write(self, highs: dict[str, int]) -> None:
        self.highs = highs
        text = " ".join(f"{table} {high}" for table, high in highs.items())
        line = f"{zlib.crc32(text.encode()):08x} {text}".ljust(160) + "\n"
        with suppress(OSError):
            os.pwrite(self._handle, line.encode(), _PLACE)


def _parsed(octets: bytes) -> dict[str, int]:
    """Return the note; nothing where there is none or it is damaged."""
    line = octets.split(b"\n")[0].decode("ascii", "replace")
    crc, _, text = line.strip().partition(" ")
    if crc != f"{zlib.crc32(text.encode()):08x}":
        return {}
    words = text.split()
    return {table: int(high) for table, high in zip(words[::2], words[1::2], strict=True) if table in _TABLES}


def _highs(path: Path) -> dict[str, int]:
    """Return the highest number of each table that a file holds or has given out; nothing where it cannot be read."""
    found: dict[str, int] = {}
    with (
        suppress(sqlite3.Error, UnicodeDecodeError, TypeError),
        closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)) as file,
    ):
        given = dict(file.execute("SELECT name, high FROM sequences"))
        for table in _TABLES:
            newest = file.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0  # noqa: S608 - own names
            found[table] = max(newest, given.get(table, 0))
    return found
