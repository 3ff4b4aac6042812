"""What an operator does to alarms of a file, through its agent or, where none runs, under its lock."""

from pathlib import Path
from typing import Any

from agent.storage.maintenance import checked_path, through_agent
from agent.storage.tables.shelves import moment
from agent.storage.write.alarm_commands import Request, carry_out, documents
from agent.storage.write.notifications import resend
from agent.storage.write.store import Store


def command_alarms(path: Path | str, request: Request) -> list[dict[str, Any]]:
    """Have alarms take a step; returns what each did once it is committed.

    Raises:
        StoreError: as `Store.open`; no such alarm, or one that refuses: then nothing is changed; no answer in
            5 s.
    """
    path = checked_path(path)
    request = Request.read(request.document())

    def act(store: Store) -> dict[str, Any]:
        return {"alarms": documents(carry_out(store, request, moment()), request)}

    return list(through_agent(path, "alarm", act, brief=True, **request.document())["alarms"])


def resend_notifications(path: Path | str, ids: list[int]) -> list[dict[str, Any]]:
    """Let notifications that were given up be tried anew; where no agent runs, by the next one.

    Raises:
        StoreError: as `Store.open`; no such notification, or one that is not dead: then nothing is changed.
    """

    def act(store: Store) -> dict[str, Any]:
        return {"notifications": resend(store, ids)}

    return list(through_agent(checked_path(path), "resend", act, brief=True, ids=ids)["notifications"])
