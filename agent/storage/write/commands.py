"""The commands that an agent does for others while it owns a database (CONTRACT section 2)."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from agent.errors import StoreError
from agent.storage.database.verify import problems
from agent.storage.recovery.salvage import Recovery
from agent.storage.write.command_socket import CommandServer, Handler
from agent.storage.write.jobs import JobQueue
from agent.storage.write.store import Store
from agent.types import Baseline


def serve(path: Path, jobs: JobQueue, on_baselines: Callable[[Store], None]) -> CommandServer:
    """Listen on the database's socket; on_baselines is called when some were stored. Raises OSError."""

    def through(act: Any) -> Handler:
        return lambda _: dict(jobs.ask(act))

    def baselines(asked: Mapping[str, Any]) -> Mapping[str, Any]:
        return dict(jobs.ask(partial(_store_baselines, asked["baselines"], on_baselines)))

    server = CommandServer(path, {"baseline": baselines, "compact": through(_compact), "repair": through(_repair)})
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


def _store_baselines(
    asked: list[dict[str, Any]], on_baselines: Callable[[Store], None], store: Store
) -> Mapping[str, Any]:
    """Store baselines, given as their fields; what runs takes them up at once."""
    try:
        found = [Baseline(**fields) for fields in asked]
    except TypeError as error:
        raise StoreError.at(str(store.path), f"no baseline was given ({error})", "use deltak baseline") from error
    numbered = store.add_baselines(found)
    on_baselines(store)
    return {"baseline_ids": [one.baseline_id for one in numbered]}
