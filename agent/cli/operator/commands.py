"""`deltak ack`, `shelve`, `unshelve`, `oos` and `return`: what an operator does to alarms."""

import getpass
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.alarms.life_cycle import Cause
from agent.cli.terminal.output import show
from agent.errors import UsageError
from agent.storage import operations
from agent.storage.maintenance import reported
from agent.storage.read.times import age_ns
from agent.storage.write.alarm_commands import Request
from agent.text import short_time


class Why(NamedTuple):
    """Who does it and why."""

    by: str | None
    comment: str | None


def act(db: Path, cause: Cause, ids: Sequence[int], why: Why, length: str | None = None) -> dict[str, Any]:
    """Have alarms take a step and return the document of what they did. Raises StoreError, UsageError."""
    request = Request(cause, tuple(ids), why.by or _user(), why.comment, _length_ns(length))
    faults = list(request.faults())
    if faults:
        raise UsageError(faults)
    with reported(db):
        return {"db": str(db), "alarms": operations.command_alarms(db, request)}


def _user() -> str:
    """Return who types; behind sudo, who asked for it."""
    try:
        return os.environ.get("SUDO_USER") or getpass.getuser()
    except (KeyError, OSError):  # a number that no name belongs to
        return f"user {os.getuid()}"


def _length_ns(length: str | None) -> int | None:
    if length is None:
        return None
    found = age_ns(length)
    if found is None:
        raise UsageError.at(
            "--for", f'"{length}" is no length of time', "give one such as 30m, 8h or 2d, at most 7d"
        )
    return found


def print_taken(document: Mapping[str, Any]) -> None:
    """Print what alarms did, a line each."""
    for alarm in document["alarms"]:
        until = f" until {short_time(alarm['shelved_until'])}" if alarm["shelved_until"] else ""
        what = f"{alarm['rig']} {alarm['kind']} {alarm['parameter']}"
        show(
            f"alarm {alarm['id']} ({what}): "
            f"{alarm['from_state']} -> {alarm['to_state']}{until} by {alarm['by']}"
        )
