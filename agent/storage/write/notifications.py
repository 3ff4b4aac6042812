# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""What becomes of notifications: delivered, tried again, given up, sent once more when somebody asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from agent.errors import Fault, StoreError
from agent.storage.database.views import ALARM_NOTES
from agent.storage.tables.notifications import NotificationRow, notification, pending
from agent.storage.tables.rows import Plan
from agent.storage.tuning import MOST_ERROR, MOST_NAMED
from agent.storage.write.store import Store
from agent.types import AlarmTransition


@dataclass(frozen=True, slots=True)
class Due:
    """A notification that is to be sent, and what it says of the alarm's step by column."""

    row: NotificationRow
    facts: dict[str, Any]


_FACTS = f"""SELECT g.name AS rig, r.code_version AS code_version, n.seq AS event_id, n.alarm_id AS alarm_id,
 a.kind AS kind, a.parameter AS parameter, a.priority AS priority, n.from_state AS from_state,
 n.to_state AS to_state, n.cause AS cause, n.by_whom AS "by", n.comment AS comment, n.t_ns AS t_ns,
 a.message AS message, a.delta AS delta, a.sd AS sd, a.limit_value AS limit_value,
 a.probability AS probability,
 {ALARM_NOTES}
 FROM alarm_events n JOIN alarms a ON a.seq = n.alarm_id JOIN runs r ON r.seq = a.run_id
 JOIN rigs g ON g.seq = r.rig_id WHERE n.seq = ?"""


def due(store: Store, target: str, most: int) -> list[Due]:
    """Return the oldest notifications still due to a target; those of steps that are no more are given up."""
    found = []
    for row in pending(store.connection, target, most):
        cursor = store.connection.execute(_FACTS, (row.alarm_event_id,))
        cells = cursor.fetchone()
        if cells is None:
            _keep(
                store,
                [replace(row, state="dead", last_error="the step of the alarm is not in the file any more")],
            )
            continue
        found.append(Due(row, dict(zip((column[0] for column in cursor.description), cells, strict=True))))
    return found


def catch_up(store: Store, target: str, wanted: Callable[[AlarmTransition], bool]) -> int:
    """Add what operators did since a target's newest notification while no agent ran; return how much it is.

    Whoever has no notification yet begins with what happens from now on.
    """
    newest = store.connection.execute(
        "SELECT max(alarm_event_id) FROM notifications WHERE target = ?", (target,)
    )
    (after,) = newest.fetchone()
    plan = Plan()
    for event_id, step in _commanded_after(store, after, target) if after is not None else ():
        if wanted(step):
            NotificationRow(store.numbers.take("notifications"), event_id, target).add_to(plan)
    added = len(plan.rows.get("notifications", ()))
    if added:
        store.commit([plan])
    return added


_COMMANDED = """SELECT n.seq, g.name, a.kind, a.parameter, a.priority, n.t_ns, n.from_state, n.to_state,
 n.cause, a.message
 FROM alarm_events n JOIN alarms a ON a.seq = n.alarm_id JOIN runs r ON r.seq = a.run_id
 JOIN rigs g ON g.seq = r.rig_id
 WHERE n.seq > ? AND n.by_whom IS NOT NULL AND NOT EXISTS (
 SELECT 1 FROM notifications x WHERE x.alarm_event_id = n.seq AND x.target = ?) ORDER BY n.seq"""


def _commanded_after(store: Store, event_id: int, target: str) -> list[tuple[int, AlarmTransition]]:
    rows = store.connection.execute(_COMMANDED, (event_id, target)).fetchall()
    return [(seq, AlarmTransition(*cells)) for seq, *cells in rows]


def note_done(store: Store, row: NotificationRow, t_ns: int) -> None:
    """Note that a target has a notification, at a time (ns)."""
    _keep(store, [replace(row, state="done", attempts=row.attempts + 1, done_ns=t_ns)])


def note_failure(store: Store, row: NotificationRow, error: str, most_attempts: int) -> bool:
    """Note why an attempt failed; tell whether it was the last one."""
    attempts = row.attempts + 1
    over = attempts >= most_attempts
    _keep(
        store,
        [replace(row, state="dead" if over else "pending", attempts=attempts, last_error=error[:MOST_ERROR])],
    )
    return over


def resend(store: Store, ids: object) -> list[dict[str, Any]]:
    """Let notifications that were given up be tried anew; all of them, or none and each refusal says why.

    Raises StoreError.
    """
    if not _are_numbers(ids):
        raise StoreError.at(
            "notification",
            "is no list of numbers",
            f"name 1 to {MOST_NAMED} of deltak notify list --dead",
        )
    asked = {seq: notification(store.connection, seq) if 0 < seq < 2**63 else None
             for seq in dict.fromkeys(ids)}  # type: ignore[call-overload]  # checked just now  # fmt: skip
    dead = [row for row in asked.values() if row is not None and row.state == "dead"]
    if len(dead) < len(asked):
        raise StoreError([_refusal(store, seq, row) for seq, row in asked.items() if row not in dead])
    rows = [replace(row, state="pending", attempts=0) for row in dead]
    _keep(store, rows)
    return [{"id": row.seq, "target": row.target, "state": row.state} for row in rows]


def _refusal(store: Store, seq: int, row: NotificationRow | None) -> Fault:
    what = "there is no such notification" if row is None else f"is not dead, but {row.state}"
    return Fault(f"notification {seq}", what, f"deltak notify list {store.path} --dead lists them")


def _are_numbers(ids: object) -> bool:
    return isinstance(ids, list) and 0 < len(ids) <= MOST_NAMED and all(type(one) is int for one in ids)


def _keep(store: Store, rows: Sequence[NotificationRow]) -> None:
    plan = Plan()
    for row in rows:
        row.add_to(plan)
    store.commit([plan])
