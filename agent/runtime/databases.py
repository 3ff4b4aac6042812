"""The databases of an agent: rigs that name the same file share one writer."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Literal

from agent import __version__
from agent.clock import boot_id, monotonic_ns, wall_ns
from agent.config import RigConfig, learnt_key
from agent.notification.routing import route
from agent.storage.tables.notifications import nobody
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import RunInfo

RunKind = Literal["live", "demo"]


def path_of(config: RigConfig, db: Path | None) -> Path:
    """Return the file of a rig's database, `db` where that is given."""
    return db if db is not None else config.store.path


def writers_of(configs: Sequence[RigConfig], db: Path | None, kind: RunKind) -> Mapping[Path, StoreWriter]:
    """Return one writer a database, by its file."""
    grouped: dict[Path, list[RigConfig]] = {}
    for config in configs:
        grouped.setdefault(path_of(config, db), []).append(config)
    return {path: _writer(path, members, kind) for path, members in grouped.items()}


def _writer(path: Path, members: Sequence[RigConfig], kind: RunKind) -> StoreWriter:
    now = wall_ns()
    boot = boot_id()
    offset = now - monotonic_ns()
    runs = [RunInfo(c.rig.name, kind, now, __version__, c.sha256, None, boot, learnt_key(c), offset, c.rig.site,
                    c.rig.labels) for c in members]  # fmt: skip
    keep = _retention(members)
    every_s = min(c.store.every_s for c in members)
    targets = partial(route, members) if kind == "live" else nobody
    return StoreWriter(lambda: Store.open(path, keep=keep, route=targets), runs, every_s=every_s, served=True)


def _retention(members: Sequence[RigConfig]) -> Retention:
    """How long rows of a shared file are kept: as long as the most patient of its configurations asks."""
    full, minute, hour = (max(getattr(c.store.keep, tier) for c in members) for tier in ("full", "minute", "hour"))
    return Retention(full, minute, hour, max(c.store.max_mb for c in members) * 1e6)
