"""What an agent runs: its rigs, the connections that they read, the writers of their databases."""

import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from agent.config import RigConfig
from agent.northbound.forwarding import Forwarding
from agent.notification.targets import Targets
from agent.recording.event_writer import EventWriter
from agent.recording.events import EventKeeper
from agent.recording.setup import event_writer, recorder
from agent.runtime.forecasts.making import Forecaster
from agent.runtime.forecasts.thread import ForecastThread
from agent.runtime.process.announcing import announce
from agent.runtime.process.databases import RunKind, Writer, path_of, writers_of
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.sources import Connection, connect
from agent.storage.tables.notifications import Route
from agent.storage.write.command_socket import Handler
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition

MakeWriters = Callable[
    [Sequence[RigConfig], Path | None, RunKind, Mapping[str, Handler], Route], Mapping[Path, Writer]
]
"""Makes one writer a database, of configurations, the common file if any, run kind, handlers and route."""


@dataclass(frozen=True, slots=True)
class Parts:
    """What some configurations need beside what is there; nothing of it is opened yet."""

    configs: Mapping[str, RigConfig]
    connections: Sequence[Connection]
    writers: Mapping[Path, Writer]
    rigs: Mapping[str, RigRuntime]
    event_writers: Mapping[str, EventWriter]


@dataclass(slots=True)
class RigSet:
    """The rigs of an agent, with all that belongs to them. The processing thread changes it; others may look.

    Attributes:
        db: the database of all, where the command line names one.
        kind: what their runs are marked as.
        wake: set when something has arrived.
        handlers: what the agent may be asked for beside its databases.
        forecasts: makes those of all rigs that have alarms.
        targets: what is notified of alarms.
        forwarding: what brings rows to consumers beyond the gateway.
        make_writers: makes what writes to databases.
    """

    db: Path | None
    kind: RunKind
    wake: threading.Event
    handlers: Mapping[str, Handler] = field(default_factory=dict)
    configs: dict[str, RigConfig] = field(default_factory=dict)
    connections: list[Connection] = field(default_factory=list)
    writers: dict[Path, Writer] = field(default_factory=dict)
    rigs: dict[str, RigRuntime] = field(default_factory=dict)
    event_writers: dict[str, EventWriter] = field(default_factory=dict)
    forecasts: ForecastThread = field(default_factory=ForecastThread)
    targets: Targets = field(default_factory=Targets)
    forwarding: Forwarding = field(default_factory=Forwarding)
    make_writers: MakeWriters = writers_of

    def make(self, configs: Sequence[RigConfig], there: Collection[str] = ()) -> Parts:
        """Make what configurations need; there: keys of the connections that are to be shared.

        Raises ConfigError, ModelError, DriverConfigError.
        """
        connections = connect(configs, self.wake, there)
        strange = [config for config in configs if path_of(config, self.db) not in self.writers]
        writers = self.make_writers(strange, self.db, self.kind, self.handlers, self.targets.route)
        for writer in writers.values():
            writer.on_alarm = self._commanded
        known = {**self.writers, **writers}
        said = announce if self.kind == "live" else lambda _: None
        rigs = {c.rig.name: RigRuntime(c, known[path_of(c, self.db)].publish, announce=said) for c in configs}
        parts = Parts({c.rig.name: c for c in configs}, connections, writers, rigs, {})
        self._record(parts, known)
        if self.kind != "live":
            return parts
        return Parts(parts.configs, connections, writers, rigs, self._keep_events(parts, known))

    def adopt(self, parts: Parts) -> None:
        """Take up what was made."""
        self.configs |= parts.configs
        self.connections += parts.connections
        self.writers |= parts.writers
        self.rigs |= parts.rigs
        self.event_writers |= parts.event_writers
        for name, config in parts.configs.items():
            self.rigs[name].summary.db = str(path_of(config, self.db))
            if self.kind == "live":
                self.forecasts.admit(name, Forecaster(config, path_of(config, self.db)))
                self.rigs[name].forecasts = self.forecasts

    def _commanded(self, step: AlarmTransition) -> None:
        """Tell the rig what was done to an alarm; alarms of others' rigs in the same file are not ours."""
        rig = self.rigs.get(step.rig)
        if rig is not None:
            rig.commanded(step)

    def writer_of(self, rig: str) -> Writer:
        """Return what writes the records of a rig."""
        return self.writers[path_of(self.configs[rig], self.db)]

    def begin(self, names: Collection[str]) -> None:
        """Let rigs go on where their last runs ended; their databases are open."""
        for name in names:
            writer = self.writer_of(name)
            self.rigs[name].summary.run_id = writer.run_ids.get(name)
            known = writer.learnt.get(name), writer.covariates.get(name, ())
            self.rigs[name].restore(writer.standing.get(name, []), *known)
            self.rigs[name].count_from(writer.baselines.get(name, ()))
            if name in self.event_writers:
                self.event_writers[name].start()
        if self.kind == "live":
            self.targets.exchange(self._placed(), self.stores)
            self.forwarding.exchange(self._placed(), self.stores)

    @property
    def stores(self) -> Mapping[Path, StoreWriter]:
        """What writes to databases in this process."""
        return {
            path: writer for path, writer in dict(self.writers).items() if isinstance(writer, StoreWriter)
        }

    def _placed(self) -> Mapping[Path, Sequence[RigConfig]]:
        """The configurations of each database."""
        placed: dict[Path, list[RigConfig]] = {path: [] for path in self.stores}
        for config in self.configs.values():
            if path_of(config, self.db) in placed:
                placed[path_of(config, self.db)].append(config)
        return placed

    def take(self) -> None:
        """Hand out what has arrived, in the order of arrival over all sources, but for rigs that are behind.

        What comes for those stays in the queues of its connections, which are bounded.
        """
        behind = {name for name, rig in self.rigs.items() if rig.waiting}
        free = [
            connection for connection in self.connections if not behind & {use.rig for use in connection.uses}
        ]
        taken = [(connection, *connection.take()) for connection in free]
        arrived = [(arrival, connection) for connection, arrivals, _ in taken for arrival in arrivals]
        for arrival, connection in sorted(arrived, key=lambda pair: pair[0].block.arrival_ns):
            for use in connection.uses:
                own = arrival if use.base is None else arrival._replace(counts=use.counts(arrival.counts))
                self.rigs[use.rig].waiting.add(use, own)
        # samples first: those that came before a loss must not end it
        noted = [
            (use, event) for connection, _, events in taken for use in connection.uses for event in events
        ]
        for use, event in noted:
            self.rigs[use.rig].waiting.add(use, event)

    def ledgers(self) -> None:
        """Publish where every sample went."""
        for rig in self.rigs.values():
            rig.ledger(self.connections)

    def _record(self, parts: Parts, writers: Mapping[Path, Writer]) -> None:
        """See that the sources with `record = true` are recorded, in a folder beside the database."""
        wanted = {(c.rig.name, s.name): c for c in parts.configs.values()
                  for s in (*c.source, *c.covariate_source) if s.record}  # fmt: skip
        for connection in parts.connections:
            for use in connection.uses:
                config = wanted.get((use.rig, use.source))
                if config is not None:
                    path = path_of(config, self.db)
                    connection.make_recorder = partial(
                        recorder, config, path, use.source, writers[path].publish
                    )

    def _keep_events(self, parts: Parts, writers: Mapping[Path, Writer]) -> dict[str, EventWriter]:
        """See that raw samples around alarms are kept, unless the configuration says that none are."""
        found = {}
        for name, config in parts.configs.items():
            if config.store.events.max_count:
                path = path_of(config, self.db)
                publish = writers[path].publish
                found[name] = event_writer(config, path, publish)
                parts.rigs[name].events = EventKeeper(config, found[name], publish)
        return found
