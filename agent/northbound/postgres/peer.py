"""Rows into PostgreSQL: copied to a table of the session, then inserted where rig and seq are not there.

COMMIT is the acknowledgement.
"""

import math
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, Final

import psycopg
from psycopg import sql

from agent.config.sections.north import North
from agent.northbound.interface.certificate import refuse_expired
from agent.northbound.interface.layout import COLUMNS, NAMES, STEADY
from agent.northbound.interface.peer import Batch, Credentials, PeerError, Place

_CAUSES: Final = {
    "28P01": "credentials", "28000": "credentials", "42501": "credentials",
    "53100": "full", "53200": "full", "53300": "full",
}  # fmt: skip
_Statement = sql.Composed


class PostgresPeer:
    """A database that gets rows.

    Args:
        consumer: its table of the configuration.
        place: the agent around it.
    """

    def __init__(self, consumer: North, place: Place) -> None:
        self._consumer, self._place = consumer, place
        self._statements: dict[str, list[bytes]] = {}
        """To copy, to compare and to insert, by topic; composing them takes as long as sending a row."""
        self._connection: psycopg.Connection[Any] | None = None
        self._credentials = Credentials(None, None)

    def open(self) -> None:
        self._credentials = Credentials.read(self._consumer, self._place.folder)
        if self._consumer.cert is not None:
            self._refuse_expired()
        with self._failing():
            self._connection = psycopg.connect(self._consumer.url or "", **self._settings())
        with self._bounded() as connection, connection.transaction():
            for topic in self._consumer.topics:
                self._prepare(connection, topic)

    def _settings(self) -> dict[str, Any]:
        consumer, folder = self._consumer, self._place.folder
        files = {"sslrootcert": consumer.ca, "sslcert": consumer.cert, "sslkey": consumer.key}
        found: dict[str, Any] = {name: str(folder / file) for name, file in files.items() if file is not None}
        if consumer.ca is not None:
            found["sslmode"] = "verify-full"
        known = {"user": self._credentials.user, "password": self._credentials.password}
        return found | {name: one for name, one in known.items() if one is not None} | {
            "connect_timeout": max(2, math.ceil(consumer.timeout_s)), "application_name": "deltak",
        }  # fmt: skip

    def _refuse_expired(self) -> None:
        try:
            refuse_expired(self._place.folder / str(self._consumer.cert))
        except (OSError, ValueError) as error:
            raise PeerError("certificate", f"{self._consumer.cert}: {error}") from error

    def deliver(self, batch: Batch) -> None:
        names = list(COLUMNS[batch.topic])
        with self._bounded() as connection, connection.transaction(), connection.cursor() as cursor:
            copying, comparing, inserting = self._statements[batch.topic]
            with cursor.copy(copying) as copy:
                for row in batch.rows:
                    copy.write_row([batch.backfill if name == "backfill" else row[name] for name in names])
            if batch.topic in STEADY:
                self._refuse_others(cursor.execute(comparing).fetchone(), batch.topic)
            cursor.execute(inserting)

    def check(self) -> None:
        if self._connection is None or self._connection.closed:
            raise PeerError("lost", "the connection is closed")

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            with suppress(psycopg.Error):
                connection.close()

    # --- statements -----------------------------------------------------------------------------------------

    def _table(self, topic: str) -> sql.Identifier:
        schema, _, prefix = self._consumer.prefix.rpartition(".")
        return sql.Identifier(*([schema] if schema else []), f"{prefix}_{NAMES[topic]}")

    def _prepare(self, connection: psycopg.Connection[Any], topic: str) -> None:
        """See that the table of a topic is there, and one of the same columns for this session."""
        table = self._table(topic)
        text = table.as_string(connection)
        if connection.execute("SELECT to_regclass(%s)", (text,)).fetchone() == (None,):
            self._create(connection, topic, text)
        staged = sql.SQL("CREATE TEMPORARY TABLE {} (LIKE {}) ON COMMIT DELETE ROWS")
        connection.execute(staged.format(_staged(topic), table))
        statements = (self._copying(topic), self._comparing(topic), self._inserting(topic))
        self._statements[topic] = [statement.as_bytes(connection) for statement in statements]

    def _create(self, connection: psycopg.Connection[Any], topic: str, text: str) -> None:
        columns = sql.SQL(", ").join(
            sql.SQL("{} ").format(sql.Identifier(name)) + sql.SQL(kind)
            for name, kind in COLUMNS[topic].items()
        )
        is_timescale = connection.execute(
            "SELECT 1 FROM pg_extension WHERE extname = 'timescaledb'"
        ).fetchone()
        key = sql.SQL("rig, seq, time" if is_timescale else "rig, seq")
        making = sql.SQL("CREATE TABLE {} ({}, PRIMARY KEY ({}))").format(self._table(topic), columns, key)
        connection.execute(making)
        if is_timescale:
            connection.execute("SELECT create_hypertable(%s::regclass, 'time')", (text,))

    def _copying(self, topic: str) -> _Statement:
        return sql.SQL("COPY {} ({}) FROM STDIN").format(_staged(topic), _columns(topic))

    def _inserting(self, topic: str) -> _Statement:
        words = "INSERT INTO {} ({}) SELECT {} FROM {} ON CONFLICT DO NOTHING"
        columns = _columns(topic)
        return sql.SQL(words).format(self._table(topic), columns, columns, _staged(topic))

    def _comparing(self, topic: str) -> _Statement:
        words = "SELECT s.rig, s.seq FROM {} s JOIN {} t USING (rig, seq) WHERE t.t_ns <> s.t_ns LIMIT 1"
        return sql.SQL(words).format(_staged(topic), self._table(topic))

    def _refuse_others(self, found: tuple[Any, ...] | None, topic: str) -> None:
        """Raise PeerError where the table has other rows under these numbers: they would be lost silently."""
        if found is not None:
            table = ".".join(self._table(topic)._obj)  # noqa: SLF001 - its words
            other = (
                f"{table} has another row of rig {found[0]} and seq {found[1]}, which another database sent"
            )
            raise PeerError("refused", f"{other}; name another prefix, or empty the table of that rig")

    # --- failures -------------------------------------------------------------------------------------------

    @contextmanager
    def _bounded(self) -> Iterator[psycopg.Connection[Any]]:
        """Yield the connection; a server that does not answer in time has it cut."""
        connection = self._connection
        if connection is None:
            raise PeerError("lost", "the connection is closed")
        over = threading.Event()
        timer = threading.Timer(self._consumer.timeout_s, _cut, (connection, over))
        timer.daemon = True
        timer.start()
        try:
            with self._failing(over):
                yield connection
        finally:
            timer.cancel()

    @contextmanager
    def _failing(self, over: threading.Event | None = None) -> Iterator[None]:
        """Make PeerError of what psycopg raises."""
        try:
            yield
        except (psycopg.Error, OSError) as error:
            if over is not None and over.is_set():
                raise PeerError("timeout", f"no answer within {self._consumer.timeout_s:g} s") from error
            words = " ".join(self._credentials.hidden(str(error)).split()) or type(error).__name__
            raise PeerError(_cause_of(error, words), words) from error


def _staged(topic: str) -> sql.Identifier:
    return sql.Identifier(f"deltak_staged_{topic}")


def _columns(topic: str) -> _Statement:
    return sql.SQL(", ").join(map(sql.Identifier, COLUMNS[topic]))


def _cut(connection: psycopg.Connection[Any], over: threading.Event) -> None:
    """End a connection that nobody answers on; whoever waits for it sees an error."""
    over.set()
    with suppress(OSError, psycopg.Error), socket.socket(fileno=os.dup(connection.fileno())) as twin:
        twin.shutdown(socket.SHUT_RDWR)


def _cause_of(error: Exception, words: str) -> str:
    state = getattr(error, "sqlstate", None)
    said = words.lower()
    if state in _CAUSES:
        return _CAUSES[state]
    signs = {
        "certificate": "certificate",
        "password": "credentials",
        "timeout": "timeout",
        "refused": "refused",
    }
    found = next((cause for sign, cause in signs.items() if sign in said), None)
    return found or ("lost" if isinstance(error, psycopg.OperationalError) else "refused")
