"""The commands that an agent does for others while it owns a database (CONTRACT section 2)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agent.storage.database.verify import problems
from agent.storage.recovery.salvage import Recovery
from agent.storage.write.command_socket import CommandServer, Handler
from agent.storage.write.jobs import JobQueue
from agent.storage.write.store import Store


def serve(path: Path, jobs: JobQueue, handlers: Mapping[str, Handler]) -> CommandServer:
    """Listen on the database's socket, for what changes it and for what others answer.

    Raises OSError where no socket can be made.
    """

    def through(act: Any) -> Handler:
        return lambda _: dict(jobs.ask(act))

    server = CommandServer(path, {"compact": through(_compact), "repair": through(_repair), **handlers})
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
