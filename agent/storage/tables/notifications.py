# ruff: noqa: S608 - statements are put together from this module's own names; values are always bound
"""Notifications as rows: written with the alarm step that they are of, so that neither is there alone."""

import sqlite3
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from agent.storage.database.checksum import checked
from agent.storage.database.columns import columns_of
from agent.storage.tables.rows import Numbers, Plan
from agent.types import AlarmTransition

Route = Callable[[AlarmTransition], Sequence[str]]
State = Literal["pending", "done", "dead"]


def nobody(_: AlarmTransition) -> Sequence[str]:
    """Return the targets of a step where there are none."""
    return ()


class Outbox:
    """What adds the notifications of an alarm's step to the transaction that stores the step.

    Args:
        route: names the targets that a step is for.
    """

    def __init__(self, route: Route = nobody) -> None:
        self._route = route

    def add(self, plan: Plan, event_id: int, step: AlarmTransition, numbers: Numbers) -> None:
        """Add a pending row a target to a plan."""
        for target in self._route(step):
            NotificationRow(numbers.take("notifications"), event_id, target).add_to(plan)


@dataclass(frozen=True, slots=True)
class NotificationRow:
    """One step of an alarm for one target, in the order of the columns of table `notifications`."""

    seq: int
    alarm_event_id: int
    target: str
    state: State = "pending"
    attempts: int = 0
    last_error: str | None = None
    done_ns: int | None = None

    def add_to(self, plan: Plan) -> None:
        """Add the row, as it is now, to a plan."""
        plan.sealed("notifications", *(getattr(self, name) for name in columns_of("notifications")[:-1]))


def notification(connection: sqlite3.Connection, seq: int) -> NotificationRow | None:
    """Return a row by its number; None where there is none that proves itself."""
    query = f"SELECT {', '.join(columns_of('notifications'))} FROM notifications WHERE seq = ?"
    return _proven(connection.execute(query, (seq,)).fetchone())


def pending(connection: sqlite3.Connection, target: str, most: int) -> list[NotificationRow]:
    """Return the oldest rows that a target is still to get, in the order of the steps."""
    query = (
        f"SELECT {', '.join(columns_of('notifications'))} FROM notifications INDEXED BY "
        "notifications_pending WHERE target = ? AND state = 'pending' ORDER BY seq LIMIT ?"
    )
    found = [_proven(cells) for cells in connection.execute(query, (target, most))]
    return [row for row in found if row is not None]


def _proven(row: tuple[Any, ...] | None) -> NotificationRow | None:
    cells = checked(row)
    return None if cells is None else NotificationRow(*cells)
