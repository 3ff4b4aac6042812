"""The commands that an agent does for others while it owns a database (CONTRACT section 2)."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from agent.storage.database.verify import problems
from agent.storage.recovery.salvage import Recovery
from agent.storage.tables.shelves import moment
from agent.storage.write.alarm_commands import Request, carry_out
from agent.storage.write.command_socket import CommandServer, Handler
from agent.storage.write.jobs import JobQueue
from agent.storage.write.notifications import resend
from agent.storage.write.store import Store
from agent.types import AlarmTransition


def serve(
    path: Path, jobs: JobQueue, notify: Callable[[AlarmTransition], None], outbox: Callable[[], None]
) -> CommandServer:
    """Listen on the database's socket. Raises OSError where no socket can be made.

    notify: called in the writer's thread with each step of an alarm that an operator made, once it is committed.
    outbox: called where there may be something to notify targets of.
    """

    def through(act: Any) -> Handler:
        return lambda _: dict(jobs.ask(act))

    def alarm(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        request = Request.read(asked)

        def act(store: Store) -> list[dict[str, Any]]:
            steps = carry_out(store, request, moment())
            for found in steps:
                notify(found.step)
            return [found.document() for found in steps if found.step.cause == request.cause]

        return {"alarms": jobs.ask(act)}

    def again(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        sent = jobs.ask(lambda store: resend(store, asked.get("ids")))
        outbox()
        return {"notifications": sent}

    handlers = {"compact": through(_compact), "repair": through(_repair), "alarm": alarm, "resend": again}
    server = CommandServer(path, handlers)
    server.start()
    return server


def _compact(store: Store) -> Mapping[str, int]:
    before = store.path.stat().st_size
    store.compact()
    return {"bytes_before": before, "bytes_after": store.path.stat().st_size}


def _repair(store: Store) -> Mapping[str, Any]:
    """Look for damage and replace a damaged file; the writer begins its runs anew in the new one."""
    found = problems(store.connection)
    if not found:
        return {"repaired": None}
    store.recover(found[0])
    recovery = store.recovery
    assert isinstance(recovery, Recovery)  # noqa: S101 - recover left it
    return {"repaired": [str(recovery.aside), recovery.cause, recovery.saved, recovery.refused, recovery.unread]}
