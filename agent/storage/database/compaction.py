"""Compaction: a file without free pages is made beside the database and copied back in one transaction.

SQLite's own VACUUM does the same, but its copying back cannot be broken off, and takes seconds for a hundred
megabytes.
"""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

from agent.storage.database.files import beside, created
from agent.storage.tuning import COPIED_PAGES


class BrokenOffError(Exception):
    """What was asked for was broken off; the database is as it was."""


def remove_left_over(path: Path) -> None:
    """Remove what a compaction left beside the database at a path when its process was killed."""
    beside(path, ".compact").unlink(missing_ok=True)


def compact(connection: sqlite3.Connection, path: Path, breaks_off: Callable[[], bool]) -> None:
    """Give an open database's free pages back to the disk; needs room for two more copies of it meanwhile.

    connection: may be interrupted. breaks_off: asked now and then.

    Raises BrokenOffError, or sqlite3.OperationalError where the connection was interrupted.
    """

    def look(*_: int) -> None:
        if breaks_off():
            raise BrokenOffError

    remove_left_over(path)
    aside = beside(path, ".compact")
    created(aside).close()
    try:
        connection.execute("VACUUM INTO ?", (str(aside),))
        with closing(sqlite3.connect(aside)) as whole:
            whole.backup(connection, pages=COPIED_PAGES, progress=look)
    finally:
        remove_left_over(path)
