"""Which databases are looked at, and what their configurations say of limits."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agent.errors import UsageError

if TYPE_CHECKING:
    from agent.config.tables import RigConfig

Limits = Mapping[str, Mapping[str, Any]]
"""By parameter: the keys `limit` and `limit_percent`, one of them None, `side` and `priority`."""


@dataclass(frozen=True, slots=True)
class Watched:
    """A database that is looked at.

    Attributes:
        name: what it is called in answers; the file's name without its ending, with a number where two are
            alike.
        path: of the file.
        configs: of its rigs, by their names, where they are known.
    """

    name: str
    path: Path
    configs: Mapping[str, "RigConfig"] = field(default_factory=dict)

    def limits(self, rig: str) -> Limits:
        """Return the limits on the levels of a rig's parameters; none without its configuration."""
        config = self.configs.get(rig)
        alarms = () if config is None else config.limits
        keys = ("limit", "limit_percent", "side", "priority")
        return {a.parameter: {key: getattr(a, key) for key in keys} for a in alarms}


def one(target: Path | None) -> Watched:
    """Return a configuration's database or the database itself; without a target the only one in this folder.

    Raises ConfigError for a configuration with faults, UsageError where no database or several are here.
    """
    if target is None:
        here = sorted(Path().glob("*.db"))
        if len(here) != 1:
            what = f"this folder has {len(here)} databases" if here else "this folder has no database"
            raise UsageError.at("watch", what, "name a configuration or a database")
        target = here[0]
    return several([], [target])[0] if target.suffix.lower() == ".toml" else several([target], [])[0]


def several(databases: Sequence[Path], configs: Iterable[Path]) -> list[Watched]:
    """Return databases with what their configurations say; those that only a configuration names come last.

    configs: files, or folders of them. Where one database is named, a configuration whose own is not there
    belongs to it: so writes an agent that runs with --db.
    """
    from agent.config.load import load_many
    from agent.config.reading.toml_file import files_of

    known: dict[Path, dict[str, RigConfig]] = {path.absolute(): {} for path in databases}
    for config in load_many(files_of(configs)):
        own = config.store.path.absolute()
        is_elsewhere = len(databases) == 1 and not own.exists()
        known.setdefault(databases[0].absolute() if is_elsewhere else own, {})[config.rig.name] = config
    found: list[Watched] = []
    for path, rigs in known.items():
        found.append(Watched(_free_name(path.stem, {other.name for other in found}), path, rigs))
    return found


def _free_name(stem: str, taken: set[str]) -> str:
    candidates = (stem, *(f"{stem}-{number}" for number in range(2, len(taken) + 3)))
    return next(name for name in candidates if name not in taken)
