"""Which rig of which database a command is about, from what was typed: a database, or a configuration."""

from dataclasses import dataclass
from pathlib import Path

from agent.blocks.graph import graph_of
from agent.config import RigConfig, load
from agent.errors import UsageError
from agent.storage.read import baselines, queries


@dataclass(frozen=True, slots=True)
class Target:
    """A rig in a database, and its configuration where that is what was given."""

    db: Path
    rig: str
    config: RigConfig | None = None

    def graph(self, first_ns: int | None = None, last_ns: int | None = None) -> str:
        """Return the graph of its rows in a stretch, empty where no run states one. Raises UsageError."""
        if first_ns is None or last_ns is None:
            found = baselines.graphs(self.db, self.rig)
        else:
            found = self._one_graph(first_ns, last_ns)
        graph = found[-1] if found else ""
        if graph and self.config is not None:
            _check_graph(self.config, graph)
        return graph

    def _one_graph(self, first_ns: int, last_ns: int) -> list[str]:
        """Return the graph of the rows of a stretch, if any. Raises UsageError for several."""
        found = baselines.graphs(self.db, self.rig, first_ns, last_ns)
        if len(found) > 1:
            what = f"the rows of {self.rig} are of {len(found)} graphs: {' | '.join(found)}"
            raise UsageError.at("--since", what, "learn from the time after the model was changed")
        return found


def _check_graph(config: RigConfig, stored: str) -> None:
    """Raise UsageError for a configuration whose graph is not that of the stored rows."""
    own = graph_of(config)
    if own != stored:
        what = f"its graph ({own}) is not that of the stored rows ({stored})"
        raise UsageError.at(config.file, what, "learn when the agent has run with it")


def target_of(path: Path, rig: str | None) -> Target:
    """Return what a command is about. Raises ConfigError, StoreError, UsageError."""
    if path.suffix.lower() == ".toml":
        config = load(path)
        return Target(config.store.path, config.rig.name, config)
    return Target(path, one_rig(path, rig))


def configured(db: Path, config: Path) -> Target:
    """Return the rig of a configuration in a database, which need not be the one that it names."""
    known = load(config)
    return Target(db, one_rig(db, known.rig.name), known)


def one_rig(db: Path, rig: str | None) -> str:
    """Return the rig that is meant. Raises StoreError; UsageError for none, several, or an unknown one."""
    known = queries.rigs(db)
    meant = known if rig is None else [name for name in known if name == rig]
    if len(meant) == 1:
        return meant[0]
    if not known:
        raise UsageError.at("--rig", "the database has no rows yet", "let the agent run first")
    what = "the database has several rigs" if meant else f'the database has no rig "{rig or ""}"'
    raise UsageError.at("--rig", what, f"rigs are {', '.join(known)}")
