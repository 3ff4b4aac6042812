"""How far rows were acknowledged, noted in DB.lock after each commit: tells a truncated log from a short one.

SQLite takes a write-ahead log up to its first wrong frame, so a flipped bit or a cut in it silently takes
away what what came after. The note is not synced: it may be older than the truth after a power cut, never
newer.

A note alone is no damage: it counts where the log itself holds rows that SQLite does not reach. Otherwise
nothing could be saved by replacing the file, and whoever forged a note would have it replaced; it is
reported and put right.
"""

import os
import sqlite3
import zlib
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path

from agent.storage.database.files import beside
from agent.storage.recovery.page_carving import scan_log
from agent.storage.tables.rows import Row
from agent.storage.tuning import MOST_AHEAD

_PLACE = 64  # fixed by SQLite's file format: after the lock's signature, in the same sector
_TABLES = {"hops": "instants", "alarm_events": "steps of alarms", "health": "ledger rows", "events": "events"}


class Watermarks:
    """The highest numbers that were acknowledged, by table.

    Args:
        handle: descriptor of the lock file.
        private: nobody but the file's owner could have written to it; what others may have written is not
            read.
    """

    def __init__(self, handle: int, *, private: bool) -> None:
        self._handle = handle
        self.highs = _parsed(os.pread(handle, 256, _PLACE)) if private else {}

    def note(self, rows: Mapping[str, list[Row]]) -> None:
        """Note rows that are on the disk now; without a place for the note things go on without it."""
        news = {table: rows[table][-1][0] for table in _TABLES if rows.get(table)}
        if news:
            self._write(
                {table: max(self.highs.get(table, 0), high) for table, high in (self.highs | news).items()}
            )

    def forget(self) -> None:
        """Begin anew, with a new file."""
        if self.highs:
            self._write({})

    def missing(self, path: Path) -> tuple[str | None, bool]:
        """Return in words what was acknowledged but is in neither database nor side file, and if it is torn.

        None for nothing. Torn: a log holds rows that cannot be reached, so the file should be replaced by
        what can be saved. Reads only, so that a log whose end is damaged stays as it is.
        """
        if not self.highs or not path.exists():
            return None, False
        files = [file for file in (path, beside(path, ".spill")) if file.exists()]
        found = [_highs(file) for file in files]
        reached = {t: max((f.get(t, high) for f in found), default=high) for t, high in self.highs.items()}
        ahead = {
            t: high - reached[t] for t, high in self.highs.items() if 0 < high - reached[t] <= MOST_AHEAD
        }
        self.highs |= {t: reached[t] for t in self.highs if t not in ahead}
        if not ahead:
            return None, False
        words = ", ".join(f"{count} {_TABLES[table]}" for table, count in ahead.items())
        torn = any(_holds_more(beside(file, "-wal"), reached) for file in files)
        return f"{words} that were acknowledged are missing", torn

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


def _holds_more(log: Path, reached: Mapping[str, int]) -> bool:
    """Tell whether a log holds rows that prove themselves with numbers beyond those that SQLite reaches."""
    return any(row[0] > reached.get(table, row[0]) for table, rows in scan_log(log) for row in rows)


def _highs(path: Path) -> dict[str, int]:
    """Return the highest number of each table that a file holds or gave out; nothing where unreadable."""
    found: dict[str, int] = {}
    with (
        suppress(sqlite3.Error, UnicodeDecodeError, TypeError),
        closing(
            sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, isolation_level=None)
        ) as file,
    ):
        given = dict(file.execute("SELECT name, high FROM sequences"))
        for table in _TABLES:
            newest = file.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0  # noqa: S608 - own names
            found[table] = max(newest, given.get(table, 0))
    return found
