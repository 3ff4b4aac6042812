"""The agent as it is now: the document of `deltak status` (CONTRACT section 8), and what metrics are made of.

Any thread may ask while the processing thread works, and even where that one hangs: nothing here waits for
it.
"""

import shutil
import sqlite3
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from agent import __version__
from agent.clock import monotonic_ns
from agent.errors import AgentError
from agent.records import Health
from agent.runtime.process.heartbeats import Heartbeats
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.rig_set import RigSet
from agent.storage.database.connect import connect_reader
from agent.storage.write.writer import StoreWriter

Document = dict[str, Any]
_STANDING = "SELECT rig, state, count(*) FROM v_alarms WHERE cleared_at IS NULL GROUP BY rig, state"


class Status:
    """What is known of an agent.

    Args:
        rigs: what it runs.
    """

    heartbeats: Heartbeats | None = None
    """Those of its threads, while somebody looks at them."""

    def __init__(self, rigs: RigSet) -> None:
        self._rigs = rigs
        self._started_ns = monotonic_ns()
        self.elsewhere: Callable[[], Sequence[Document]] = list
        """Gives the rigs that other processes of the agent run, as `rigs` gives one's own."""
        self.workers: Callable[[], Sequence[Document]] = list
        """Gives those processes."""

    def words(self) -> str:
        """Return the agent in one line, for `systemctl status`."""
        lags = {name: rig.lag_s() for name, rig in dict(self._rigs.rigs).items()}
        lags |= {rig["rig"]: rig["lag_s"] for rig in self.elsewhere()}
        parts = [f"{name} {_lag_words(lag_s)}" for name, lag_s in lags.items()]
        shown = ", ".join(parts[:8]) + (", ..." if len(parts) > 8 else "")
        return f"{len(parts)} {'rig' if len(parts) == 1 else 'rigs'}: {shown}"

    def document(self) -> Document:
        """Return all of it."""
        standing = self.standing()
        return {
            "version": __version__,
            "uptime_s": (monotonic_ns() - self._started_ns) / 1e9,
            "rigs": [
                _with_alarms(rig, standing.get(rig["rig"], {})) for rig in [*self.rigs(), *self.elsewhere()]
            ],
            "stores": [_store(path, writer) for path, writer in self._rigs.stores.items()],
            "north": self._rigs.forwarding.documents(),
            "threads": self._threads(),
            "workers": list(self.workers()),
            "configs": [str(config.file) for config in list(self._rigs.configs.values())],
        }

    def rigs(self) -> list[Document]:
        """Return the rigs that this process runs, but for their alarms."""
        return [self._rig(rig) for rig in dict(self._rigs.rigs).values()]

    def standing(self) -> dict[str, dict[str, int]]:
        """Return the alarms whose condition stands, by rig and state, as the databases have them."""
        found: dict[str, dict[str, int]] = {}
        for path in list(self._rigs.writers):
            with suppress(AgentError, sqlite3.Error, OSError), closing(connect_reader(path)) as connection:
                for rig, state, count in connection.execute(_STANDING):
                    found.setdefault(rig, {})[state] = count
        return found

    def _rig(self, rig: RigRuntime) -> Document:
        ledgers = rig.summary.ledgers()
        return {
            "rig": rig.config.rig.name, "run_id": rig.summary.run_id, "db": rig.summary.db,
            "lag_s": rig.lag_s(),
            "sources": [self._source(rig, source, ledgers.get(source)) for source in rig.sources],
            "estimates": {p: {k: row[k] for k in ("value", "sd", "unit", "status", "reason", "t_ns")}
                          for p, row in rig.summary.estimates().items()},
            "clock_steps": rig.clock_steps, "clock_offset_s": rig.clock_offset_s(),
        }  # fmt: skip

    def _source(self, rig: RigRuntime, source: str, ledger: Health | None) -> Document:
        found: Document = {"source": source, "state": self._state(rig, source)}
        if ledger is not None:
            found |= {
                "received": ledger.received, "used": ledger.used, "rejected": dict(ledger.rejected),
                "dropped": dict(ledger.dropped), "gaps": ledger.gaps,
            }  # fmt: skip
        return found

    def _state(self, rig: RigRuntime, source: str) -> str:
        """Return "ok", "lost" (tried again), or "ended" (a fault that no trying mends)."""
        own = (rig.config.rig.name, source)
        read = [
            c for c in list(self._rigs.connections) if any((use.rig, use.source) == own for use in c.uses)
        ]
        if any(connection.progress and not connection.is_alive() for connection in read):
            return "ended"
        return "lost" if rig.is_lost(source) else "ok"

    def _threads(self) -> list[Document]:
        beats = {} if self.heartbeats is None else self.heartbeats.beats
        return [
            {"thread": name, "alive": beat.alive, "stalled": beat.stalled, "silent_s": beat.silent_s,
             "progress": beat.progress}
            for name, beat in beats.items()
        ]  # fmt: skip


def _with_alarms(rig: Document, standing: Mapping[str, int]) -> Document:
    return {**rig, "alarms": sum(standing.values()), "alarm_states": dict(standing)}


def _lag_words(lag_s: float | None) -> str:
    return "no sample yet" if lag_s is None else f"{max(lag_s, 0.0):.1f} s behind"


def _beside(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except OSError:
        return 0


def _entries(folder: Path) -> list[Path]:
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _store(path: Path, writer: StoreWriter) -> Document:
    files = {"database": path, "log": _beside(path, "-wal"), "side": _beside(path, ".spill")}
    folders = {"recordings": _beside(path, ".raw"), "events": _beside(path, ".events")}
    sizes = {name: _size(file) for name, file in files.items()}
    sizes |= {name: sum(map(_size, _entries(folder))) for name, folder in folders.items()}
    return {
        "db": str(path), "bytes": sizes, "failing": writer.failing, "written": writer.written,
        "dropped": dict(writer.dropped), "spare_bytes": shutil.disk_usage(path.parent).free,
        "latency": {rig: {"bins": found.cumulated(), "sum_s": found.sum_s}
                    for rig, found in dict(writer.latency).items()},
    }  # fmt: skip
