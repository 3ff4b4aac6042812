"""What an operator does to alarms of a file, through its agent or, where none runs, under its lock."""

from pathlib import Path
from typing import Any

from agent.errors import StoreError, StoreHeldError
from agent.storage.database.files import Kind, check_place, kind_of
from agent.storage.maintenance import ask_holder, is_commanded
from agent.storage.tables.shelves import moment
from agent.storage.write.alarm_commands import Request, carry_out
from agent.storage.write.command_socket import ask
from agent.storage.write.notifications import resend
from agent.storage.write.store import Store


def command_alarms(path: Path | str, request: Request) -> list[dict[str, Any]]:
    """Have alarms take a step; returns what each did once it is committed.

    Raises:
        StoreError: as `Store.open`; no such alarm, or one that refuses: then nothing is changed; no answer in
            5 s.
    """
    path = _existing(path)
    request = Request.read(request.document())
    asked = {"brief": True, **request.document()}
    if is_commanded(path):
        return list(ask(path, "alarm", **asked)["alarms"])
    try:
        with Store.open(path) as store:
            return [found.document() for found in carry_out(store, request, moment())
                    if found.step.cause == request.cause]  # fmt: skip
    except StoreHeldError as held:
        return list(ask_holder(path, "alarm", held, **asked)["alarms"])


def resend_notifications(path: Path | str, ids: list[int]) -> list[dict[str, Any]]:
    """Let notifications that were given up be tried anew; where no agent runs, by the next one.

    Raises:
        StoreError: as `Store.open`; no such notification, or one that is not dead: then nothing is changed.
    """
    path = _existing(path)
    if is_commanded(path):
        return list(ask(path, "resend", brief=True, ids=ids)["notifications"])
    try:
        with Store.open(path) as store:
            return resend(store, ids)
    except StoreHeldError as held:
        return list(ask_holder(path, "resend", held, brief=True, ids=ids)["notifications"])


def _existing(path: Path | str) -> Path:
    path = Path(path)
    check_place(path)
    if kind_of(path) is Kind.MISSING:
        raise StoreError.at(str(path), "there is no such database", "give the path that the agent writes to")
    return path
