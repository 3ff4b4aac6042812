"""Cursors of consumers: up to which number of each table a consumer has acknowledged the rows.

Table `consumers` has a row a consumer and topic: last_seq is the number up to which all is acknowledged.
Where newer rows were sent before older ones, further rows of topics `<topic>.1`, `.2` ... say where what is
acknowledged begins and ends again: up to last_seq, from `.1` to `.2`, and so on; the last is the newest row
that was acknowledged.
"""

import sqlite3
from collections.abc import Collection, Mapping
from contextlib import AbstractContextManager
from typing import Protocol

from agent.storage.write.consumers.unsent import TABLE_OF, announced, counter_of

Edges = tuple[int, ...]
_KEEP = """INSERT INTO consumers (name, topic, last_seq) VALUES (?, ?, ?)
 ON CONFLICT (name, topic) DO UPDATE SET last_seq = excluded.last_seq"""


class Transactions(Protocol):
    """What is asked of the store here: its connection, and its transactions."""

    @property
    def connection(self) -> sqlite3.Connection: ...
    def transaction(self) -> AbstractContextManager[sqlite3.Connection]: ...


def edges_of(connection: sqlite3.Connection, name: str, topic: str) -> Edges | None:
    """Return the edges of what a consumer has of a topic, ascending; None for one that has no cursor yet."""
    query = "SELECT topic, last_seq FROM consumers WHERE name = ? AND (topic = ? OR topic GLOB ? || '.*')"
    found = dict(connection.execute(query, (name, topic, topic)).fetchall())
    if topic not in found:
        return None
    edges = [found.pop(topic)]
    while (more := found.pop(f"{topic}.{len(edges)}", None)) is not None:
        edges.append(more)
    is_sound = len(edges) % 2 == 1 and edges == sorted(edges)
    return tuple(edges) if is_sound else (edges[0],)


def begin(store: Transactions, name: str, firsts: Mapping[str, int]) -> dict[str, Edges]:
    """Return how far a consumer has each topic it gets, from now on no other; the first edge of new ones."""
    _drop_others(store, name, firsts)
    return {topic: edges_of(store.connection, name, topic) or (first,) for topic, first in firsts.items()}


def keep(store: Transactions, name: str, positions: Mapping[str, Edges], numbers: Mapping[str, int]) -> int:
    """Store a consumer's edges by topic, and its own numbers; return how many rows it lost since last asked.

    Those were purged before it had them, since the file or a table of it reached its bound.
    """
    lost, counted = announced(store.connection, name)
    with store.transaction() as connection:
        for topic, edges in positions.items():
            connection.execute("DELETE FROM consumers WHERE name = ? AND topic GLOB ? || '.*'", (name, topic))
            places = [topic, *(f"{topic}.{i}" for i in range(1, len(edges)))]
            connection.executemany(
                _KEEP, [(name, place, edge) for place, edge in zip(places, edges, strict=True)]
            )
        connection.executemany(_KEEP, [(name, key, number) for key, number in numbers.items()])
        if lost:
            connection.execute(_KEEP, (name, counter_of(name), counted))
    return lost


def forget_others(store: Transactions, names: Collection[str]) -> list[str]:
    """Drop the cursors of former consumers, whose rows would be kept for ever; return their names."""
    known = {name for (name,) in store.connection.execute("SELECT DISTINCT name FROM consumers")}
    gone = sorted(known - set(names))
    if gone:
        with store.transaction() as connection:
            connection.executemany("DELETE FROM consumers WHERE name = ?", [(name,) for name in gone])
    return gone


def _drop_others(store: Transactions, name: str, topics: Collection[str]) -> None:
    held = [
        topic for (topic,) in store.connection.execute("SELECT topic FROM consumers WHERE name = ?", (name,))
    ]
    others = {*TABLE_OF} - {*topics}
    strange = [(name, topic) for topic in held if topic.split(".")[0] in others]
    if strange:
        with store.transaction() as connection:
            connection.executemany("DELETE FROM consumers WHERE name = ? AND topic = ?", strange)
