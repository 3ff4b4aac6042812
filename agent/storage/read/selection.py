"""What a question to a database is about: which rigs, which parameter, which stretches of time."""

import logging
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NamedTuple

from agent.errors import Fault, UsageError
from agent.storage.database.connect import Reader, connect_reader, unreadable
from agent.storage.read.proof import FIRST, LAST, prove_names, prove_parts
from agent.storage.read.times import age_ns, parse_time
from agent.storage.tables.ages import newest_of, parts_of, shifts

log = logging.getLogger(__name__)


class Stretch(NamedTuple):
    """Rows asked for: of a part of a run, from `first` to `last` (stamps, ns); stamp + shift is true time."""

    part: int
    shift: int
    first: int
    last: int

    def after(self, true_ns: int) -> "Stretch":
        """Return what of it is not before an instant of true time."""
        return self._replace(first=max(self.first, true_ns - self.shift))


@contextmanager
def reading(db: Path | str) -> Iterator[Reader]:
    """Open a database for one question; what SQLite finds wrong with it becomes a StoreError."""
    with closing(connect_reader(Path(db))) as connection:
        try:
            connection.execute("BEGIN")  # rows and what proves them are of one state
            prove_names(connection)
            yield connection
            tell_refused(db, connection.refused)
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            raise unreadable(Path(db), error) from error


def tell_refused(db: Path | str, count: int) -> None:
    """Warn of rows that are not shown."""
    if count:
        words = "%s: %d rows are not shown, their checksums are wrong; `deltak db check` tells more"
        log.warning(words, db, count)


def rigs_of(connection: sqlite3.Connection) -> list[str]:
    """Return the names of the rigs, as they came."""
    return [name for (name,) in connection.execute("SELECT name FROM rigs ORDER BY seq")]


def parameters_of(connection: sqlite3.Connection, rig: str | None) -> list[str]:
    """Return the names of the parameters of a rig, of all rigs where it is None."""
    query = (
        "SELECT s.parameter FROM series s JOIN runs r ON r.seq = s.run_id JOIN rigs g ON g.seq = r.rig_id "
        "WHERE ?1 IS NULL OR g.name = ?1 GROUP BY s.parameter ORDER BY min(s.seq)"
    )
    return [name for (name,) in connection.execute(query, (rig,))]


def chosen_rigs(connection: sqlite3.Connection, rig: str | None) -> list[str]:
    """Return the rigs meant; UsageError for one that the file does not know."""
    known = rigs_of(connection)
    if rig is None:
        return known
    if rig not in known:
        raise UsageError([Fault("--rig", f'the database has no rig "{rig}"', f"rigs are {_list(known)}")])
    return [rig]


def one_rig(connection: sqlite3.Connection, rig: str | None) -> str:
    """Return the rig meant; UsageError where there are several to choose from, or none."""
    known = chosen_rigs(connection, rig)
    if len(known) != 1:
        what = "the database has several rigs" if known else "the database has no rows yet"
        raise UsageError(
            [Fault("--rig", what, f"name one of {_list(known)}" if known else "let the agent run first")]
        )
    return known[0]


def check_parameter(connection: sqlite3.Connection, rig: str | None, parameter: str | None) -> None:
    """Raise UsageError for a parameter that the rig, or any, has no rows of while it has of others.

    Where there is no row at all none can be told to be unknown: the agent may not have come to one yet.
    """
    known = parameters_of(connection, rig)
    if parameter is not None and known and parameter not in known:
        raise UsageError(
            [
                Fault(
                    "parameter",
                    f'the database has no parameter "{parameter}"',
                    f"parameters are {_list(known)}",
                )
            ]
        )


def _list(names: Sequence[str]) -> str:
    return ", ".join(names) or "none yet"


def stretches_of(
    connection: Reader, rig: str, since: str | None, until: str | None
) -> tuple[list[Stretch], int, int]:
    """Return what was asked for by run part, and its first and last instant (ns); open ends reach far enough.

    An age counts in true time back from the newest row, a date is compared with the stamps as they are.
    """
    parts = parts_of(connection, rig)
    prove_parts(connection, rig, parts)
    shift = shifts(parts)
    newest = newest_of(parts, shift)
    first = FIRST if since is None else min(parse_time(since, newest, "--since"), LAST)
    last = LAST if until is None else max(parse_time(until, newest, "--until"), FIRST)
    if first > last:
        raise UsageError([Fault("--since", f'"{since}" is later than --until "{until}"', "swap them")])
    by_age = [text is not None and age_ns(text) is not None for text in (since, until)]
    found = []
    for part in parts:
        ends = [t - shift[part.seq] if age else t for t, age in zip((first, last), by_age, strict=True)]
        found.append(Stretch(part.seq, shift[part.seq], *(min(max(t, FIRST), LAST) for t in ends)))
    return found, first, last
