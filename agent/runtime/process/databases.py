"""The databases of an agent: rigs that name the same file share one writer."""

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Literal, Protocol

from agent import __version__
from agent.blocks.graph import graph_of
from agent.clock import boot_id, monotonic_ns, wall_ns
from agent.config import RigConfig, learnt_key
from agent.records import Baseline, CovariateMean, Record, RunInfo
from agent.storage.tables.alarms import AlarmRow
from agent.storage.tables.notifications import Route, nobody
from agent.storage.write.command_socket import Handler
from agent.storage.write.retention import Density, Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition, Learnt

RunKind = Literal["live", "demo"]


class Writer(Protocol):
    """What writes the records of rigs to their database, in this process or in another.

    Attributes:
        on_alarm: called with each step that an alarm took by an operator or as a shelf ended.
        run_ids, standing, learnt, baselines, covariates: what the runs of its rigs began with, by rig.
        broken: what ended it for good, in words.
    """

    on_alarm: Callable[[AlarmTransition], None]
    run_ids: dict[str, int]
    standing: dict[str, list[AlarmRow]]
    learnt: dict[str, Learnt | None]
    baselines: dict[str, tuple[Baseline, ...]]
    covariates: dict[str, list[CovariateMean]]
    broken: str | None

    @property
    def failing(self) -> str | None:
        """Why nothing can be written at present."""

    def start(self) -> None:
        """Begin the runs; raises StoreError where that can never work."""

    def publish(self, records: Sequence[Record]) -> None:
        """Take records; never blocks."""

    def exchange(self, leaving: Collection[str], entering: Sequence[RunInfo], density: Density) -> None:
        """End the runs of some rigs and begin others. Raises StoreError."""

    def hurry(self) -> None:
        """Let nothing hold up the writing of rows any more."""

    def stop(self, timeout_s: float = 10.0) -> None:
        """Bring what is left to the disk, and end."""


def path_of(config: RigConfig, db: Path | None) -> Path:
    """Return the file of a rig's database, `db` where that is given."""
    return db if db is not None else config.store.path


def writers_of(
    configs: Sequence[RigConfig], db: Path | None, kind: RunKind,
    handlers: Mapping[str, Handler] | None = None,
    route: Route = nobody,
) -> dict[Path, StoreWriter]:  # fmt: skip
    """Return one writer a database, by its file.

    handlers: what it may be asked for beside it. route: whom steps of alarms are for.
    """
    grouped: dict[Path, list[RigConfig]] = {}
    for config in configs:
        grouped.setdefault(path_of(config, db), []).append(config)
    announced = route if kind == "live" else nobody
    return {path: writer_of(path, runs_of(members, kind), members, handlers or {}, announced)
            for path, members in grouped.items()}  # fmt: skip


def runs_of(configs: Sequence[RigConfig], kind: RunKind) -> list[RunInfo]:
    """Return what the runs of some rigs that begin now are."""
    now = wall_ns()
    boot = boot_id()
    offset = now - monotonic_ns()
    return [
        RunInfo(
            c.rig.name, kind, now, __version__, c.sha256, None, boot, learnt_key(c), offset, c.rig.site,
            c.rig.labels, graph_of(c),
        ) for c in configs
    ]  # fmt: skip


def writer_of(
    path: Path,
    runs: Sequence[RunInfo],
    members: Sequence[RigConfig],
    handlers: Mapping[str, Handler],
    route: Route,
) -> StoreWriter:
    """Return the writer of one database, for runs of some of the configurations that share it."""
    every_s, keep, commit_s = density_of(members)
    return StoreWriter(
        lambda: Store.open(path, keep=keep, route=route),
        runs,
        every_s=every_s,
        period_s=commit_s,
        served=handlers,
    )


def density_of(members: Sequence[RigConfig]) -> Density:
    """Return a shared file's: rows kept as long as the most patient of its configurations asks."""
    full, minute, hour = (
        max(getattr(c.store.keep, tier) for c in members) for tier in ("full", "minute", "hour")
    )
    keep = Retention(full, minute, hour, max(c.store.max_mb for c in members) * 1e6)
    return Density(min(c.store.every_s for c in members), keep, min(c.store.commit_s for c in members))
