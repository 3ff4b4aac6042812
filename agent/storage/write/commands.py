"""The commands that an agent does for others while it owns a database (CONTRACT section 2)."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from agent.errors import StoreError
from agent.records import Baseline
from agent.storage.database.verify import problems
from agent.storage.recovery.salvage import Recovery
from agent.storage.tables.shelves import moment
from agent.storage.write.alarm_commands import Request, carry_out, documents
from agent.storage.write.command_socket import CommandServer, Handler
from agent.storage.write.jobs import JobQueue
from agent.storage.write.notifications import resend
from agent.storage.write.store import Store
from agent.types import AlarmTransition


class Listeners(NamedTuple):
    """Who is called, in the writer's thread, of what commands did, once it is committed.

    Attributes:
        alarm: each step of an alarm that an operator made.
        baselines: some were stored.
        outbox: there may be something to notify targets of.
    """

    alarm: Callable[[AlarmTransition], None]
    baselines: Callable[[Store], None]
    outbox: Callable[[], None]


def serve(path: Path, jobs: JobQueue, listeners: Listeners, handlers: Mapping[str, Handler]) -> CommandServer:
    """Listen on the database's socket, for what changes it and for what others answer.

    Raises OSError where no socket can be made.
    """

    def through(act: Any) -> Handler:
        return lambda _: dict(jobs.ask(act))

    def alarm(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        request = Request.read(asked)

        def act(store: Store) -> list[dict[str, Any]]:
            steps = carry_out(store, request, moment())
            for found in steps:
                listeners.alarm(found.step)
            return documents(steps, request)

        return {"alarms": jobs.ask(act)}

    def baselines(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        return dict(jobs.ask(partial(_store_baselines, asked["baselines"], listeners.baselines)))

    def again(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        sent = jobs.ask(lambda store: resend(store, asked.get("ids")))
        listeners.outbox()
        return {"notifications": sent}

    own = {
        "alarm": alarm, "baseline": baselines, "compact": through(Store.compact), "repair": through(_repair),
        "resend": again,
    }  # fmt: skip
    server = CommandServer(path, {**own, **handlers})
    server.start()
    return server


def _repair(store: Store) -> Mapping[str, Any]:
    """Look for damage and replace a damaged file; the writer begins its runs anew in the new one."""
    found = problems(store.connection)
    if not found:
        return {"repaired": None}
    store.recover(found[0])
    recovery = store.recovery
    assert isinstance(recovery, Recovery)  # noqa: S101 - recover left it
    return {
        "repaired": [str(recovery.aside), recovery.cause, recovery.saved, recovery.refused, recovery.unread]
    }


def _store_baselines(
    asked: list[dict[str, Any]], on_baselines: Callable[[Store], None], store: Store
) -> Mapping[str, Any]:
    """Store baselines, given as their fields; what runs takes them up at once."""
    try:
        found = [Baseline(**fields) for fields in asked]
    except TypeError as error:
        raise StoreError.at(store.path, f"no baseline was given ({error})", "use deltak baseline") from error
    numbered = store.add_baselines(found)
    on_baselines(store)
    return {"baseline_ids": [one.baseline_id for one in numbered]}
