"""Sessions of those who may acknowledge, kept in memory, and the limit on attempts to open one."""

import hashlib
import secrets
from collections import OrderedDict
from dataclasses import dataclass, field

from agent.cli.tuning import FAILED_HOSTS, FAILURES, FAILURES_S, MOST_SESSIONS, SESSION_S
from agent.clock import monotonic_ns


def _now_s() -> float:
    return monotonic_ns() / 1e9


@dataclass(frozen=True, slots=True)
class Session:
    """Somebody who knows the secret: the name given, and what each of their writes must bring along."""

    name: str
    csrf: str
    ends_s: float


@dataclass(slots=True)
class Sessions:
    """Open sessions by the hash of their cookie's value."""

    _open: OrderedDict[str, Session] = field(default_factory=OrderedDict)

    def begin(self, name: str) -> tuple[str, Session]:
        """Open a session and return the value of its cookie with it."""
        value = secrets.token_urlsafe(32)
        session = Session(name, secrets.token_urlsafe(32), _now_s() + SESSION_S)
        self._open[_key(value)] = session
        while len(self._open) > MOST_SESSIONS:
            self._open.popitem(last=False)
        return value, session

    def find(self, value: str | None) -> Session | None:
        """Return the session of a cookie's value; None where there is none or its time is over."""
        session = self._open.get(_key(value or ""))
        return session if session is not None and session.ends_s > _now_s() else None

    def end(self, value: str | None) -> None:
        """Close a session; harmless where there is none."""
        self._open.pop(_key(value or ""), None)


def _key(value: str) -> str:
    return hashlib.sha256(value.encode("utf-8", "replace")).hexdigest()


@dataclass(slots=True)
class Attempts:
    """Wrong passwords by address, of the last minute."""

    _failed: OrderedDict[str, list[float]] = field(default_factory=OrderedDict)

    def wait_s(self, address: str) -> float:
        """Return how long an address has to wait before it may try; 0 for at once."""
        recent = self._recent(address)
        return max(0.0, recent[-FAILURES] + FAILURES_S - _now_s()) if len(recent) >= FAILURES else 0.0

    def fail(self, address: str) -> None:
        """Count a wrong password."""
        self._failed[address] = [*self._recent(address), _now_s()]
        self._failed.move_to_end(address)
        while len(self._failed) > FAILED_HOSTS:
            self._failed.popitem(last=False)

    def _recent(self, address: str) -> list[float]:
        return [t for t in self._failed.get(address, ()) if t > _now_s() - FAILURES_S]
