"""`deltak run`: configurations are read, and run by the agent itself or by workers."""

import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from agent.clock import monotonic_ns
from agent.config import RigConfig, driver_class, files_of, load_many
from agent.errors import ConfigError, Fault
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.process.databases import RunKind
from agent.runtime.process.memory import keep_heap_small
from agent.runtime.process.requests import Request
from agent.runtime.service import Reread, Service
from agent.runtime.workers.spread import wanted_workers
from drivers.port import DriverConfigError


def run(
    *, configs: Sequence[Path], db: Path | None, duration_s: float | None, kind: RunKind = "live"
) -> dict[str, Any]:
    """Run the agent; return one rig's document, or {"runs": [...]} for several.

    configs: files, or folders of them. kind: marks the run in the database. Raises ConfigError, ModelError,
    StoreError.
    """
    keep_heap_small()

    def reread() -> Sequence[RigConfig]:
        found = load_many(files_of(configs))
        _need_sources(found)
        return found

    rigs = reread()
    started = monotonic_ns()
    try:
        service = _service(rigs, db, kind, reread)
    except DriverConfigError as error:
        raise source_error(rigs, error) from error
    with service.lines.kept(), _handled(service):
        service.run(duration_s)
    seconds = (monotonic_ns() - started) / 1e9
    documents = service.documents(seconds)
    return documents[0] if len(documents) == 1 else {"runs": documents}


def _service(configs: Sequence[RigConfig], db: Path | None, kind: RunKind, reread: Reread) -> Service:
    most = wanted_workers(configs)
    if most <= 1:
        return Service(configs, db, kind, reread)

    from agent.runtime.workers.service import SpreadService

    return SpreadService(configs, db, kind, most, reread)


@contextmanager
def _handled(service: Service) -> Iterator[None]:
    """Have SIGTERM end a service and SIGHUP reload its configuration; a closed terminal still ends it."""
    wanted = {signal.SIGTERM: Request(service.stop, "stop")}
    if not os.isatty(0):
        wanted[signal.SIGHUP] = Request(service.reload, "reload")
    previous = {number: signal.signal(number, request) for number, request in wanted.items()}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
            wanted[number].end()


def _need_sources(rigs: Sequence[RigConfig]) -> None:
    missing = [rig for rig in rigs if not rig.source]
    faults = [
        Fault("source", f"{rig.file} has no [[source]]", "name the bus to listen to") for rig in missing
    ]
    for rig in rigs:
        for i, source in enumerate((*rig.source, *rig.covariate_source)):
            if driver_class(source.driver).finite:
                faults.append(
                    Fault(f"source[{i}].driver", f'"{source.driver}" is a recording', "use deltak replay")
                )
    if faults:
        raise ConfigError(faults)
