"""`deltak notify list`, `resend` and `test`: what became of notifications, and if targets can be reached."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from agent.cli.terminal.output import fault_document, print_rows, print_table, show
from agent.clock import wall_ns
from agent.config import RigConfig, load
from agent.config.sections.results import Notify
from agent.errors import Fault, UsageError
from agent.notification.message import Message, message_of
from agent.notification.senders import SendError, send
from agent.storage import operations
from agent.storage.maintenance import reported
from agent.storage.read import queries
from agent.text import short_time

_LOOK: Final = "see that the target can be reached, and its secrets"
COLUMNS: Final = ("id", "alarm_event_id", "target", "state", "attempts", "last_error", "done_at")


def listed(db: Path, form: str, *, dead: bool) -> None:
    """Print a file's notifications, oldest first; dead: only those given up. Raises StoreError."""
    rows = queries.notifications(db, "dead" if dead else None)
    if form != "table":
        print_rows("notifications", COLUMNS, rows, form, rows.refused)
    elif not rows:
        show("no notifications")
    else:
        print_table("", COLUMNS, (_cells(row) for row in rows), right=("id", "attempts"))


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    done = short_time(row["done_at"])
    facts = [str(row[name]) for name in ("id", "alarm_event_id", "target", "state", "attempts")]
    return (*facts, row["last_error"] or "", done)


def resend(db: Path, ids: list[int]) -> dict[str, Any]:
    """Let notifications that were given up be tried anew. Raises StoreError."""
    with reported(db):
        return {"db": str(db), "notifications": operations.resend_notifications(db, ids)}


def print_resent(document: Mapping[str, Any]) -> None:
    """Print which notifications are tried anew, a line each."""
    for row in document["notifications"]:
        show(f"notification {row['id']} to {row['target']}: {row['state']}")


def test(config: Path) -> dict[str, Any]:
    """Message each target, whatever its hours and priorities. Raises ConfigError; UsageError without any."""
    rig = load(config)
    if not rig.notify:
        raise UsageError.at("notify", f"{config} has no [[notify]]", "add one for each target")
    found = list(_tested(rig))
    errors = [
        fault_document(
            Fault(f"notify[{place}]", f'"{one["target"]}" has not got the message: {one["error"]}', _LOOK)
        )
        for place, one in enumerate(found)
        if one["error"] is not None
    ]
    return {"targets": found, "ok": not errors, "errors": errors}


def _tested(rig: RigConfig) -> Iterator[dict[str, Any]]:
    for target in rig.notify:
        error = None
        try:
            send(target, _message(rig, target), rig.folder)
        except SendError as failure:
            error = str(failure)
        yield {"target": target.name, "kind": target.kind, "error": error}


def _message(rig: RigConfig, target: Notify) -> Message:
    facts = dict.fromkeys(("by", "comment", "delta", "sd", "limit_value", "probability", "percent", "labels"))
    said = f"a test of target {target.name}: no alarm was raised"
    return message_of({
        **facts, "rig": rig.rig.name, "site": rig.rig.site, "event_id": "test", "alarm_id": 0, "kind": "test",
        "parameter": target.name, "priority": "low", "from_state": "NORM", "to_state": "NORM",
        "cause": "test", "t_ns": wall_ns(), "message": said, "advice": "nothing",
    })  # fmt: skip


def print_tested(document: Mapping[str, Any]) -> None:
    """Print whether each target has its message."""
    rows = ((one["target"], one["kind"], one["error"] or "has the message") for one in document["targets"])
    print_table("", ("target", "kind", "result"), rows)
