"""Databases of an agent with rigs in workers: records published, runs begun and ended, as workers ask."""

import logging
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar

from agent.config import RigConfig
from agent.errors import AgentError, StoreError
from agent.records import Baseline
from agent.runtime.process.databases import density_of, path_of, runs_of, writer_of
from agent.runtime.rig_set import RigSet
from agent.runtime.tuning import AGAIN_S
from agent.runtime.workers.losses import Losses, batches_of
from agent.runtime.workers.piped import Batch, Facts, Runs
from agent.storage.tables.notifications import nobody
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition

Found = TypeVar("Found")
log = logging.getLogger(__name__)


class WorkersDatabases:
    """The databases of an agent, as its workers use them.

    Args:
        rigs: holds their writers, and the configurations.
        losses: counts what was lost where a worker ended.
        on_alarm: called with each step of an alarm that no worker made.
        is_reloading: tells whether configurations are being exchanged.
        stopped: set when the agent is asked to end.

    Attributes:
        coming: configurations that are about to be run.
        baselines: those that workers know of, by rig.
        ending: whether the agent is at its end.
    """

    def __init__(
        self, rigs: RigSet, losses: Losses, on_alarm: Callable[[AlarmTransition], None],
        is_reloading: Callable[[], bool], stopped: threading.Event,
    ) -> None:  # fmt: skip
        self._rigs, self._losses = rigs, losses
        self._on_alarm, self._is_reloading = on_alarm, is_reloading
        self._stopped = stopped
        self._opening = threading.Lock()
        self._fresh: set[str] = set()
        self.coming: tuple[RigConfig, ...] = ()
        self.baselines: dict[str, tuple[Baseline, ...]] = {}
        self.ending = False

    def make(self, configs: Sequence[RigConfig]) -> None:
        """Make the writers of configurations, with a run for each; they are not opened yet."""
        self._rigs.configs |= {config.rig.name: config for config in configs}
        for path in dict.fromkeys(path_of(config, self._rigs.db) for config in configs):
            self._rigs.writers[path] = self._new_writer(path, configs)
        self._fresh = set(self._rigs.configs)

    def publish(self, batch: Batch) -> None:
        """Hand a worker's records to their writer, and say what was lost before them."""
        writer = self._rigs.writers.get(batch.path)
        if not isinstance(writer, StoreWriter):
            return
        writer.dropped_at_queue.update(batch.dropped)
        for rows in batches_of(batch.records):
            config = self._rigs.configs.get(rows.rig)
            if config is not None:
                writer.publish(self._losses.see(config, rows))
        writer.publish(batch.records)

    def begin_runs(self, runs: Runs) -> Facts:
        """End runs and begin others; returns what these begin with. Raises StoreError."""
        with self._opening:
            while True:
                try:
                    return self._begun(runs)
                except StoreError:
                    # while a reload is refused for it, a worker that was started anew waits for the disk
                    if self._is_reloading() or self.ending:
                        raise
                if self._stopped.wait(AGAIN_S):
                    raise AgentError.at(runs.path, "the agent is ending")

    def _begun(self, runs: Runs) -> Facts:
        writer = self._opened(runs.path)
        names = [run.rig for run in runs.entering]
        leaving = {*runs.leaving, *names} - self._fresh
        if leaving:
            writer.exchange(tuple(leaving), runs.entering, density_of(self._members(runs.path)))
        self._fresh -= set(names)
        facts = Facts(
            _of(names, writer.run_ids), _of(names, writer.standing), _of(names, writer.learnt),
            _of(names, writer.baselines), _of(names, writer.covariates),
        )  # fmt: skip
        self.baselines |= facts.baselines
        return facts

    def end_runs(self, runs: Runs) -> None:
        """End the runs of rigs that left a worker."""
        writer = self._rigs.writers.get(runs.path)
        members = self._members(runs.path)
        if writer is None or not members or self.ending:
            return  # it is closed, or about to be
        try:
            writer.exchange(runs.leaving, (), density_of(members))
        except AgentError as error:
            log.warning("%s: runs that ended are still open: %s", runs.path, error)

    def _opened(self, path: Path) -> StoreWriter:
        """Return the writer of a database, opened now where no rig used it before. Raises StoreError."""
        if path not in self._rigs.writers:
            fresh = self._new_writer(path, ())
            fresh.start()
            self._rigs.writers[path] = fresh
        return self._rigs.stores[path]

    def _new_writer(self, path: Path, configs: Sequence[RigConfig]) -> StoreWriter:
        """Make a writer, with runs for those of some configurations that name its file."""
        members = [config for config in configs if path_of(config, self._rigs.db) == path]
        route = self._rigs.targets.route if self._rigs.kind == "live" else nobody
        writer = writer_of(
            path, runs_of(members, self._rigs.kind), self._members(path), self._rigs.handlers, route
        )
        writer.on_alarm = self._on_alarm
        return writer

    def _members(self, path: Path) -> list[RigConfig]:
        """Return the configurations that share a database, as they are or are about to be."""
        known = {**self._rigs.configs, **{config.rig.name: config for config in self.coming}}
        return [config for config in known.values() if path_of(config, self._rigs.db) == path]

    def close_without_rigs(self) -> None:
        """Close the databases that no rig names any more."""
        used = {path_of(config, self._rigs.db) for config in self._rigs.configs.values()}
        for path in set(self._rigs.writers) - used:
            self._rigs.writers.pop(path).stop()


def _of(names: Sequence[str], table: Mapping[str, Found]) -> dict[str, Found]:
    """Return what a table has of some names."""
    return {name: table[name] for name in names if name in table}
