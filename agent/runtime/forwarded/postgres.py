"""The tables of a consumer of kind postgres, as histories.

The part of the address behind "#" is the consumer's prefix. A password stands in what libpq reads it from
(PGPASSWORD, a password file), or in the address; it is in no message.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

from agent.errors import UsageError
from agent.northbound.interface.layout import NAMES
from agent.runtime.forwarded.tiers import COLUMNS, History, piece_of
from agent.runtime.tuning import ROWS_READ
from agent.units import DAY_NS

if TYPE_CHECKING:
    from psycopg.sql import Composed

SCHEMES: Final = ("postgresql://", "postgres://")
_PREFIX: Final = "deltak"
_UNSEEN = re.compile(r"(?<=://).*@|\?.*", re.DOTALL)
"""What messages do not show of an address: who signs in, and further settings."""
_RIGS: Final = """WITH RECURSIVE r(rig) AS (SELECT min(rig) FROM {t}
 UNION ALL SELECT (SELECT min(rig) FROM {t} WHERE rig > r.rig) FROM r WHERE r.rig IS NOT NULL)
 SELECT rig FROM r WHERE rig IS NOT NULL ORDER BY rig"""
_LIMITS: Final = """SELECT parameter, limit_value FROM {t}
 WHERE rig = %s AND kind = 'level' AND limit_value IS NOT NULL ORDER BY seq"""


def is_address(text: str) -> bool:
    """Tell whether something is the address of a PostgreSQL database."""
    return text.startswith(SCHEMES)


class PostgresHistories:
    """Rows that a server has. Raises UsageError where it cannot be asked."""

    def __init__(self, address: str) -> None:
        self._url, _, prefix = address.partition("#")
        self._prefix = prefix or _PREFIX
        self._shown = _UNSEEN.sub("", self._url)

    @cached_property
    def rigs(self) -> list[str]:
        """The names of the rigs; found by the primary key, since a table of all rows is long."""
        return [rig for (rig,) in self._asked(_RIGS, "estimates")]

    def history(self, rig: str, most: int) -> History:
        """Return what there is of a rig, day after day."""
        found = History(rig, most)
        query = f"SELECT {', '.join(COLUMNS)} FROM {{t}} WHERE rig = %s ORDER BY t_ns"  # noqa: S608 own names
        place = COLUMNS.index("t_ns")
        for _, rows in groupby(self._asked(query, "estimates", rig), lambda row: row[place] // DAY_NS):
            found.take(piece_of(zip(*rows, strict=True)))
        return found

    def limits(self, rig: str) -> dict[str, float]:
        """Return the limits that level alarms of a rig were last raised at, by parameter."""
        return dict(self._asked(_LIMITS, "alarms", rig))

    @cached_property
    def _settings(self) -> dict[str, Any]:
        """The address taken apart; of one that cannot be, libpq would quote a piece, the password perhaps."""
        from psycopg import ProgrammingError
        from psycopg.conninfo import conninfo_to_dict

        try:
            found = dict(conninfo_to_dict(self._url, connect_timeout=10, application_name="deltak"))
        except ProgrammingError:
            found = {"host": "@"}
        if "@" in str(found.get("host")):
            advice = "write postgresql://user@host/database, and odd characters of a password as %40 for @"
            raise UsageError.at(self._shown, "is no address of a database", advice)
        return found

    def _asked(self, query: str, topic: str, *values: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a query on a topic's table, of which the server hands out some at once."""
        with self._failing():
            import psycopg

            with (
                psycopg.connect(**self._settings) as connection,
                connection.cursor("deltak_fleet") as cursor,
            ):
                connection.read_only = True
                cursor.itersize = ROWS_READ
                cursor.execute(self._on(query, topic), values)
                yield from cursor

    def _on(self, query: str, topic: str) -> "Composed":
        from psycopg import sql

        schema, _, prefix = self._prefix.rpartition(".")
        names = [*([schema] if schema else []), f"{prefix}_{NAMES[topic]}"]
        return sql.SQL(query).format(t=sql.Identifier(*names))

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """Make UsageError of what the library raises, without a password."""
        try:
            import psycopg
        except ImportError as error:
            advice = "pip install 'deltak[postgres]'"
            raise UsageError.at(self._shown, "psycopg is not installed", advice) from error
        try:
            yield
        except (psycopg.Error, OSError) as error:
            said = str(error)
            for secret in (self._settings.get(key) for key in ("password", "sslpassword")):
                said = said.replace(secret, "***") if secret else said
            what = " ".join(said.split())
            advice = "see the address, the role's rights, and the prefix behind #"
            raise UsageError.at(self._shown, f"cannot be read: {what}", advice) from None
