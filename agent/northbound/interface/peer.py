"""Peer: whoever gets rows, behind one interface; a kind each implements it.

PeerError is all that a peer may raise; trying again may help.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from agent.config.reading.secrets import Secret
from agent.config.sections.north import North

Row = Mapping[str, Any]


class PeerError(Exception):
    """A peer does not have what was sent, or nobody knows.

    Attributes:
        cause: in a word or two, as events have it: refused, lost, timeout, credentials, certificate, full ...
    """

    def __init__(self, cause: str, message: str) -> None:
        super().__init__(message)
        self.cause = cause


class Batch(NamedTuple):
    """Rows of one topic, in the order of their numbers; backfill: whether newer ones may have gone before."""

    topic: str
    rows: Sequence[Row]
    after: int
    backfill: bool


@dataclass(frozen=True, slots=True)
class Place:
    """What a peer may ask of the agent.

    Attributes:
        db: the database that the rows are of.
        folder: where the configuration's relative paths start.
        rigs: those whose configuration names the consumer.
        newest: returns the newest estimate of each rig and parameter.
        number: returns a number that the consumer keeps in the database; 0 at first.
        keep_number: has one kept with the next cursor.
        waiting: called again and again while a peer is waited for; tells whether to go on.
        wake: has the peer looked at soon; from any thread.
    """

    db: Path
    folder: Path
    rigs: tuple[str, ...] = ()
    newest: Callable[[], Sequence[Row]] = tuple
    number: Callable[[str], int] = lambda _: 0
    keep_number: Callable[[str, int], None] = lambda _key, _number: None
    waiting: Callable[[], bool] = lambda: True
    wake: Callable[[], None] = lambda: None


class Peer(Protocol):
    """One connection to a consumer; made anew after each failure."""

    def open(self) -> None:
        """Connect; return when rows can be delivered. Raises PeerError."""

    def deliver(self, batch: Batch) -> None:
        """Bring rows to the consumer; return when it has acknowledged all of them. Raises PeerError."""

    def check(self) -> None:
        """Look whether the connection is still there. Raises PeerError."""

    def close(self) -> None:
        """Leave; never raises, and takes no longer than a second or two."""


MakePeer = Callable[[North, Place], Peer]


@dataclass(frozen=True, slots=True)
class Credentials:
    """Name and password for a consumer, read at each attempt; `hidden` takes them out of words."""

    user: str | None
    password: str | None = field(repr=False)

    @classmethod
    def read(cls, consumer: North, folder: Path) -> "Credentials":
        """Read what the configuration names. Raises PeerError."""
        try:
            secret: Secret | None = consumer.password
            password = None if secret is None else secret.read(folder, dict(os.environ))
        except KeyError as error:
            words = f"the environment variable {error.args[0]} that leads to the password is not set"
            raise PeerError("credentials", words) from error
        except (OSError, UnicodeDecodeError) as error:
            raise PeerError("credentials", f"the password cannot be read ({type(error).__name__})") from error
        return cls(consumer.user, password)

    def hidden(self, words: str) -> str:
        """Return words without the password, should a peer have said it."""
        return words.replace(self.password, "***") if self.password else words
