"""What stands in a worker for the writer of a database: it brings records to the agent, which writes them."""

import threading
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from agent.config import RigConfig
from agent.records import Baseline, CovariateMean, Record, RunInfo
from agent.runtime.process.databases import RunKind, path_of, runs_of
from agent.runtime.tuning import MOST_CELLS
from agent.runtime.workers.link import Link, Tell
from agent.storage.tables.alarms import AlarmRow
from agent.storage.tables.notifications import Route
from agent.storage.write.backlog import Backlog
from agent.storage.write.command_socket import Handler
from agent.storage.write.retention import Density
from agent.types import AlarmTransition, Learnt

RECORDS, BEGIN, LEFT = "records", "begin", "left"
"""Records to be stored; runs to be begun, in the place of others; runs that ended."""


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs of one database that end, by their rigs, and others that begin."""

    path: Path
    leaving: tuple[str, ...]
    entering: tuple[RunInfo, ...]


@dataclass(frozen=True, slots=True)
class Batch:
    """Records of one database, and how many rows before them were dropped, by reason."""

    path: Path
    records: Sequence[Record]
    dropped: Counter[str]


@dataclass(frozen=True, slots=True)
class Facts:
    """What runs begin with, by rig."""

    run_ids: Mapping[str, int] = field(default_factory=dict)
    standing: Mapping[str, list[AlarmRow]] = field(default_factory=dict)
    learnt: Mapping[str, Learnt | None] = field(default_factory=dict)
    baselines: Mapping[str, tuple[Baseline, ...]] = field(default_factory=dict)
    covariates: Mapping[str, list[CovariateMean]] = field(default_factory=dict)


class PipedWriter:
    """One database as a worker knows it.

    Args:
        link: to the agent.
        path: the database.
        runs: those that begin with it.
    """

    def __init__(self, link: Link, path: Path, runs: Sequence[RunInfo]) -> None:
        self._link, self._path = link, path
        self._runs = tuple(runs)
        self._lock = threading.Lock()
        self._backlog = Backlog(MOST_CELLS)
        self._reported: Counter[str] = Counter()
        self._posted = False
        self.on_alarm: Callable[[AlarmTransition], None] = lambda _: None
        self.run_ids: dict[str, int] = {}
        self.standing: dict[str, list[AlarmRow]] = {}
        self.learnt: dict[str, Learnt | None] = {}
        self.baselines: dict[str, tuple[Baseline, ...]] = {}
        self.covariates: dict[str, list[CovariateMean]] = {}
        self.broken: str | None = None

    @property
    def failing(self) -> str | None:
        """Why nothing reaches the agent; None where all does. Whether that can write is its own affair."""
        return "the agent ended" if self._link.ended else None

    def start(self) -> None:
        """Have the runs begun. Raises AgentError where that cannot be done."""
        self._begin((), self._runs)

    def publish(self, records: Sequence[Record]) -> None:
        """Take records, which are sent at once; never blocks. Where the agent takes none the oldest go."""
        with self._lock:
            self._backlog.add(records, "agent busy")
            posted, self._posted = self._posted, True
        if not posted:
            self._link.post(self._taken)

    def exchange(self, leaving: Collection[str], entering: Sequence[RunInfo], density: Density) -> None:
        """Have runs ended and others begun; the agent knows what other workers' rigs ask of the file."""
        del density
        self._begin(tuple(leaving), tuple(entering))

    def hurry(self) -> None:
        """Do nothing: whatever holds up the writing is the agent's."""

    def stop(self, timeout_s: float = 10.0) -> None:
        """End the runs; what was published is sent before."""
        self._link.tell(LEFT, Runs(self._path, tuple(self.run_ids), ()))
        self._link.drain(timeout_s)

    def _begin(self, leaving: tuple[str, ...], entering: tuple[RunInfo, ...]) -> None:
        facts: Facts = self._link.ask(BEGIN, Runs(self._path, leaving, entering)).result()
        for rig in leaving:
            for table in (self.run_ids, self.standing, self.learnt, self.baselines, self.covariates):
                table.pop(rig, None)
        self.run_ids |= facts.run_ids
        self.standing |= facts.standing
        self.learnt |= facts.learnt
        self.baselines = {**self.baselines, **facts.baselines}
        self.covariates |= facts.covariates

    def _taken(self) -> Tell:
        with self._lock:
            self._posted = False
            dropped = self._backlog.dropped - self._reported
            self._reported = self._backlog.dropped.copy()
            return Tell(RECORDS, Batch(self._path, self._backlog.take(), dropped))


def piped_writers(
    link: Link, configs: Sequence[RigConfig], db: Path | None, kind: RunKind, handlers: Mapping[str, Handler],
    route: Route,
) -> dict[Path, PipedWriter]:  # fmt: skip
    """Return one writer a database, by its file; whoever commands and is notified does so at the agent."""
    del handlers, route
    grouped: dict[Path, list[RigConfig]] = {}
    for config in configs:
        grouped.setdefault(path_of(config, db), []).append(config)
    return {path: PipedWriter(link, path, runs_of(members, kind)) for path, members in grouped.items()}
