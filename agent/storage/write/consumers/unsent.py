"""Rows purged though a consumer does not have them yet: kept from it where age asks, counted where size does.

The count of each consumer stands in `counters`; what of it was announced stands with its cursors.
"""

import sqlite3
from collections.abc import Callable, Sequence

Count = Callable[[str, int], None]
TABLE_OF = {"alarms": "alarm_events", "estimates": "hops", "events": "events", "health": "health"}
"""The table whose seq is a topic's cursor; that of estimates counts columns too (seq >> COLUMN_BITS)."""


def counter_of(name: str) -> str:
    """Return the counter of what a consumer lost, also the topic of the announced count."""
    return f"purged unsent: {name}"


def acknowledged(connection: sqlite3.Connection, topic: str) -> int | None:
    """Return the number up to which every consumer of a topic has its rows; None where it has no consumer."""
    query = "SELECT min(last_seq) FROM consumers WHERE topic = ?"
    found = connection.execute(query, (topic,)).fetchone()[0]
    return None if found is None else int(found)


def count_unsent(
    connection: sqlite3.Connection, topic: str, purged: Sequence[int], count: Count, bits: int = 0
) -> None:
    """Count, for each consumer of a topic, the rows that are purged before it has them.

    Args:
        connection: of the file.
        topic: of the rows.
        purged: their numbers.
        count: adds to a counter of the file.
        bits: by which a cursor is shifted to the right to be one of these numbers.
    """
    known = connection.execute("SELECT name, last_seq FROM consumers WHERE topic = ?", (topic,)).fetchall()
    for name, last_seq in known:
        unsent = sum(seq > last_seq >> bits for seq in purged)
        if unsent:
            count(counter_of(name), unsent)


def announced(connection: sqlite3.Connection, name: str) -> tuple[int, int]:
    """Return how many rows a consumer lost since that was announced, and how many to announce in all."""
    total = connection.execute("SELECT count FROM counters WHERE name = ?", (counter_of(name),)).fetchone()
    said = connection.execute(
        "SELECT last_seq FROM consumers WHERE name = ? AND topic = ?", (name, counter_of(name))
    ).fetchone()
    counted = int(total[0]) if total else 0
    return max(0, counted - (int(said[0]) if said else 0)), counted
