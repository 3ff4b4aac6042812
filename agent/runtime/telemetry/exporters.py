"""Where metrics go: an HTTP address that is scraped, a file that node_exporter's textfile collector reads."""

import logging
import os
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from agent.config import Metrics, RigConfig
from agent.runtime.tuning import TEXTFILE_S
from agent.storage.database.files import opened

Document = Callable[[], Mapping[str, Any]]

log = logging.getLogger(__name__)


class Exporter(Protocol):
    """Something that gives metrics to others until it is stopped."""

    def stop(self) -> None:
        """End it."""


class Exporters:
    """The exporters that the configurations of an agent ask for; an address that two name is one exporter.

    None of them can end the agent: an address that is taken, or a folder that is away, is a warning.

    status: makes the status document.
    """

    def __init__(self, status: Document) -> None:
        self._status = status
        self._running: dict[str | Path, Exporter] = {}

    def exchange(self, configs: Iterable[RigConfig]) -> None:
        """Run what configurations ask for, and nothing else."""
        wanted = {place for config in configs for place in _places(config.metrics)}
        for place in set(self._running) - wanted:
            self._running.pop(place).stop()
        for place in sorted(wanted - set(self._running), key=str):
            self._begin(place)

    def stop(self) -> None:
        """End all."""
        self.exchange(())

    def _begin(self, place: str | Path) -> None:
        make: Callable[[Any, Any], Exporter] = TextfileExporter if isinstance(place, Path) else HttpExporter
        try:
            self._running[place] = make(place, self._status)
        except OSError as error:
            log.warning("metrics: %s cannot be used: %s", place, error.strerror or error)


def _places(metrics: Metrics) -> list[str | Path]:
    return [place for place in (metrics.listen, metrics.textfile) if place is not None]


def _registry(status: Document) -> Any:
    from prometheus_client.registry import CollectorRegistry

    from agent.runtime.telemetry.metrics import AgentCollector

    registry = CollectorRegistry(auto_describe=False)
    registry.register(AgentCollector(status))
    return registry


class HttpExporter:
    """Answers GET /metrics at an address; without a password (docs/configuration.md, [metrics])."""

    def __init__(self, listen: str, status: Document) -> None:
        from prometheus_client.exposition import start_http_server

        host, _, port = listen.rpartition(":")
        self._server, self._thread = start_http_server(int(port), host.strip("[]"), _registry(status))
        self.port: int = self._server.server_port

    def stop(self) -> None:
        """End the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class TextfileExporter:
    """Writes a file anew each period, whole at any time."""

    def __init__(self, file: Path, status: Document) -> None:
        self._file = file
        self._registry = _registry(status)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="metrics", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it and remove the file: figures of an agent that ended are none."""
        self._stop.set()
        self._thread.join()
        with suppress(OSError):
            self._file.unlink(missing_ok=True)

    def _work(self) -> None:
        while True:
            try:
                self._write()
            except OSError as error:
                log.warning("metrics: %s cannot be written: %s", self._file, error.strerror or error)
            if self._stop.wait(TEXTFILE_S):
                return

    def _write(self) -> None:
        """Write the file under another name first; through a symbolic link there nothing is written."""
        from prometheus_client.exposition import generate_latest

        part = self._file.with_name(f"{self._file.name}.part")
        part.unlink(missing_ok=True)
        with os.fdopen(opened(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644), "wb") as file:
            file.write(generate_latest(self._registry))
        part.replace(self._file)
