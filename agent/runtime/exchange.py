"""A changed configuration while the agent runs: rigs whose file changed start anew, others lose no sample.

Everything that may fail is made and opened before the first rig is touched.
"""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from agent.clock import monotonic_ns, wall_ns
from agent.config import RigConfig
from agent.config.tables import Source
from agent.errors import AgentError, StoreError
from agent.records import HealthEvent
from agent.runtime.process.databases import density_of, path_of, runs_of
from agent.runtime.rig_set import Parts, RigSet
from agent.runtime.sources import Connection
from agent.runtime.tuning import CLOSE_S, FINISH_S, LEAVE_S

CONFIGURATION = "configuration"
"""What events of a reload are told of."""
Within = Callable[[Callable[[], object]], bool]
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Plan:
    """Which rigs leave and which enter; one that changes does both.

    Attributes:
        together: those of them whose file did not change: they share a source that must be opened anew.
    """

    leaving: tuple[str, ...]
    entering: tuple[RigConfig, ...]
    together: tuple[str, ...]

    def document(self, untouched: Sequence[str]) -> dict[str, Any]:
        """Return what a reload did, as `deltak reload --json` prints it."""
        entering = {config.rig.name for config in self.entering}
        return {
            "restarted": [name for name in self.leaving if name in entering],
            "added": sorted(entering - set(self.leaving)),
            "removed": [name for name in self.leaving if name not in entering],
            "untouched": list(untouched),
        }


def plan(rigs: RigSet, configs: Sequence[RigConfig]) -> Plan:
    """Compare what runs with what shall run."""
    new = {config.rig.name: config for config in configs}
    touched = {name for name, config in rigs.configs.items() if new.get(name) != config}
    changed = frozenset(touched)
    while more := _drawn_in(rigs, touched, new):
        touched |= more
    entering = tuple(c for name, c in new.items() if name in touched or name not in rigs.configs)
    leaving = tuple(name for name in rigs.configs if name in touched)
    return Plan(leaving, entering, tuple(sorted(touched - changed)))


def _drawn_in(rigs: RigSet, touched: set[str], new: Mapping[str, RigConfig]) -> set[str]:
    """Return rigs that are not touched themselves, but share a source that cannot go on as it is."""
    joining = [c for name, c in new.items() if name in touched or name not in rigs.configs]
    found: set[str] = set()
    for connection in rigs.connections:
        users = {use.rig for use in connection.uses}
        is_recorded = connection.make_recorder is not None and bool(users & touched)
        if is_recorded or not all(connection.serves(source) for _, source in _sharing(joining, connection)):
            found |= users - touched
    return found


def _sharing(configs: Sequence[RigConfig], connection: Connection) -> list[tuple[RigConfig, Source]]:
    return [(c, source) for c in configs for source in (*c.source, *c.covariate_source)
            if source.connection(c.folder) == connection.key]  # fmt: skip


@dataclass(frozen=True, slots=True)
class Prepared:
    """A plan with all that it needs, made and opened.

    Attributes:
        kept: the connections that go on.
    """

    plan: Plan
    parts: Parts
    kept: Sequence[Connection]


def prepare(rigs: RigSet, wanted: Plan) -> Prepared:
    """Make what enters and open its databases, which may take minutes; nothing that runs is touched.

    Raises AgentError or DriverConfigError where something cannot be made or opened.
    """
    failing = next((path for path, writer in rigs.writers.items() if writer.failing), None)
    if failing is not None:
        raise AgentError.at(failing, "cannot be written at present", "reload again when it can")
    kept = [c for c in rigs.connections if any(use.rig not in wanted.leaving for use in c.uses)]
    parts = rigs.make(wanted.entering, [connection.key for connection in kept])
    try:
        for writer in parts.writers.values():
            writer.start()
    except AgentError:
        for writer in parts.writers.values():
            writer.stop()
        raise
    return Prepared(wanted, parts, kept)


def exchange(rigs: RigSet, prepared: Prepared, within: Within) -> None:
    """Let rigs leave and enter; called by the processing thread.

    within: does something, or breaks it off when the agent must end.

    Raises RuntimeError where a database refuses at this very moment: an agent started anew begins with the
    new files.
    """
    wanted, parts = prepared.plan, prepared.parts
    _leave(rigs, wanted.leaving, within)
    try:
        _settle_databases(rigs, wanted)
    except StoreError as error:
        raise RuntimeError(f"the configuration cannot be exchanged: {error}") from error
    rigs.connections[:] = prepared.kept
    for connection in prepared.kept:
        connection.leave(wanted.leaving)
        for config, source in _sharing(wanted.entering, connection):
            connection.admit(config.rig.name, source)
    rigs.adopt(parts)
    rigs.begin(list(parts.configs))
    for connection in parts.connections:
        connection.start()
    _tell(rigs, wanted)


def _leave(rigs: RigSet, leaving: Sequence[str], within: Within) -> None:
    """End the sources that only leaving rigs read, and compute what came of them."""
    ending = [c for c in rigs.connections if all(use.rig in leaving for use in c.uses)]
    for connection in ending:
        connection.end()
    for connection in ending:
        connection.stop(CLOSE_S)
    _compute(rigs, leaving, monotonic_ns() + round(LEAVE_S * 1e9), within)
    for name in leaving:
        rig = rigs.rigs[name]
        rig.give_up()
        within(rig.finish)
        rig.ledger(rigs.connections)
        if name in rigs.event_writers:
            rigs.event_writers.pop(name).stop(FINISH_S)


def _compute(rigs: RigSet, leaving: Sequence[str], until: int, within: Within) -> None:
    """Compute what waits for rigs that leave, until then at most (monotonic, ns)."""
    while monotonic_ns() < until:
        rigs.take()
        if not any(rigs.rigs[name].waiting for name in leaving):
            return
        for name in leaving:
            within(rigs.rigs[name].work)


def _settle_databases(rigs: RigSet, wanted: Plan) -> None:
    """End the runs of what leaves and begin those of what enters, in each database kept; close the others."""
    for path, writer in list(rigs.writers.items()):
        leaving = [name for name in wanted.leaving if path_of(rigs.configs[name], rigs.db) == path]
        entering = [config for config in wanted.entering if path_of(config, rigs.db) == path]
        stay = [name for name, config in rigs.configs.items() if path_of(config, rigs.db) == path]
        if not entering and set(stay) == set(leaving):
            rigs.writers.pop(path).stop()
        elif leaving or entering:
            members = [*entering, *(rigs.configs[name] for name in stay if name not in leaving)]
            writer.exchange(leaving, runs_of(entering, rigs.kind), density_of(members))
    for name in wanted.leaving:
        del rigs.configs[name], rigs.rigs[name]
        rigs.forecasts.leave(name)


def _tell(rigs: RigSet, wanted: Plan) -> None:
    for config in wanted.entering:
        name = config.rig.name
        begun = "begins anew" if name in wanted.leaving else "begins"
        why = (
            "; its file did not change, but it shares a source with one whose did"
            if name in wanted.together
            else ""
        )
        tell(rigs, [name], "reloaded", f"the configuration was reloaded: {name} {begun}{why}")


def tell(rigs: RigSet, names: Sequence[str], cause: str, words: str) -> None:
    """Log what became of a reload, and make it an event of some rigs."""
    log.warning("%s", words)
    for name in names:
        rigs.writer_of(name).publish([HealthEvent(name, CONFIGURATION, wall_ns(), cause, words)])
