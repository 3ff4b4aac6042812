"""`deltak run`: configurations are read, and run by the agent itself or by workers."""

import os
import signal
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from agent.clock import monotonic_ns
from agent.config import RigConfig, driver_class, files_of, load_many
from agent.errors import ConfigError, Fault
from agent.runtime.assembly.source_faults import source_error
from agent.runtime.process.databases import RunKind
from agent.runtime.process.memory import keep_heap_small
from agent.runtime.process.requests import asked_by
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

    with ExitStack() as signals:
        # a closed terminal ends the agent, a SIGHUP while it starts does not
        hangup = None if os.isatty(0) else signals.enter_context(asked_by(signal.SIGHUP, "reload"))
        rigs = reread()
        started = monotonic_ns()
        try:
            service = _service(rigs, db, kind, reread)
        except DriverConfigError as error:
            raise source_error(rigs, error) from error
        signals.enter_context(asked_by(signal.SIGTERM, "stop")).begin(service.stop)
        if hangup is not None:
            hangup.begin(service.reload)
        with service.lines.kept():
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
