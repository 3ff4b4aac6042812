# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""How many rows a damaged file has lost, as far as that can be known.

What is known of rows that are gone: those that were read and were wrong, those that an index still lists,
those that were acknowledged (see `Watermarks`), and the estimates that a saved instant lacks. Pages that
cannot be read may have held more.
"""

import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

REPORTED = ("estimates", "alarms", "alarm_events", "health", "events")
"""What people count as rows."""
_INDEXES = {
    "hops": "hops_by_time", "alarms": "alarms_by_run", "alarm_events": "alarm_events_by_alarm",
    "health": "health_by_run",
}  # fmt: skip
_MISSING = """SELECT coalesce(sum(max(0, q.n - (SELECT count(*) FROM estimates e
 JOIN fits f ON f.seq = e.fit_id
 WHERE e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023 AND f.chosen = 1))), 0)
 FROM temp.reached h
 JOIN (SELECT run_id, count(DISTINCT parameter) AS n FROM series GROUP BY run_id) q ON q.run_id = h.run_id
 WHERE h.span = 0"""


@dataclass(slots=True)
class LossEstimate:
    """What is known of the rows of a damaged file that could not be read from it.

    Attributes:
        seen: numbers of rows, by table, that were there: read and wrong, or listed by an index.
        unread: something in the file could not be read, so there may have been more.
    """

    seen: dict[str, set[int]] = field(default_factory=dict)
    unread: bool = True

    def begin(self, target: sqlite3.Connection) -> None:
        """Make room for notes in the file that takes the saved rows; they end with its connection."""
        target.execute("CREATE TEMP TABLE reached (seq INTEGER PRIMARY KEY, run_id INTEGER, span INTEGER)")

    def note(self, table: str, numbers: Iterable[object]) -> None:
        """Note rows that were there."""
        self.seen.setdefault(table, set()).update(n for n in numbers if isinstance(n, int))

    def _look(self, source: sqlite3.Connection, most: int) -> None:
        """Note the rows that the indexes of a file list, with numbers up to the highest that can be."""
        for table, index in _INDEXES.items():
            with suppress(sqlite3.Error, UnicodeDecodeError):
                for (number,) in source.execute(f"SELECT seq FROM {table} INDEXED BY {index}"):
                    if isinstance(number, int) and 0 < number <= most:
                        self.note(table, [number])

    def settle(self, source: sqlite3.Connection, target: sqlite3.Connection, failures: int) -> None:
        """Note what file and log list, and which instants of it were reached; pages hold purged ones too."""
        newest = 0
        for table in _INDEXES:
            with suppress(sqlite3.Error, UnicodeDecodeError):
                newest = max(newest, source.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0)
        self._look(source, newest)
        target.execute("INSERT INTO temp.reached SELECT seq, run_id, span FROM hops")
        self.unread = failures > 0 or not _whole(source)

    def count(self, target: sqlite3.Connection, highs: Mapping[str, int]) -> int:
        """Return how many rows are known to be lost, with those that were saved in target."""
        given = dict(target.execute("SELECT name, high FROM sequences"))
        tables = {*self.seen, *highs}
        gone = {
            table: self._gone(target, table, highs.get(table, 0), given.get(table, 0)) for table in tables
        }
        fewest = "SELECT min(n) FROM (SELECT count(DISTINCT parameter) AS n FROM series GROUP BY run_id)"
        width = int(target.execute(fewest).fetchone()[0] or 1)
        missing = int(target.execute(_MISSING).fetchone()[0]) + width * gone.pop("hops", 0)
        return max(gone.pop("estimates", 0), missing) + sum(gone.values())

    def _gone(self, target: sqlite3.Connection, table: str, high: int, given: int) -> int:
        """Return how many rows of a table were there but not saved; high: the highest acknowledged."""
        query = f"SELECT 1 FROM {table} WHERE seq = ?"
        gone = sum(target.execute(query, (number,)).fetchone() is None for number in self.seen.get(table, ()))
        newest = int(target.execute(f"SELECT max(seq) FROM {table}").fetchone()[0] or 0)
        return max(gone, high - max(newest, given))


def _whole(source: sqlite3.Connection) -> bool:
    """Tell whether nothing but the content of rows can be wrong."""
    with suppress(sqlite3.Error, UnicodeDecodeError):
        return bool(source.execute("PRAGMA integrity_check(1)").fetchone()[0] == "ok")
    return False
