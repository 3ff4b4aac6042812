"""Which agent a command means: named by a database, a configuration, a folder of them, or the only one."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agent.config import RigConfig, files_of, load
from agent.errors import StoreError, UsageError
from agent.storage.database.files import beside
from agent.storage.write.command_socket import ask

PLACES = (Path(), Path("/var/lib/deltak"))
"""Where databases are looked for that nobody names: here, and where the service keeps them."""

_START = (
    "start it: deltak run, or systemctl start deltak; name the database of one that was started with --db"
)


def database_of(named: Path | None) -> Path:
    """Return the database whose socket is to be asked.

    An agent that runs on a configuration with another --db is found where that lies here, beside the
    configuration, beside its own database or in the service's folder.

    Raises ConfigError for a configuration with faults, StoreError where no agent runs, UsageError where
    several do.
    """
    if named is None:
        return _only_one()
    if named.suffix == ".toml" or named.is_dir():
        config = load(files_of([named])[0])
        own = config.store.path
        return own if _answers(own) else _elsewhere(config) or own
    return named


def _elsewhere(config: RigConfig) -> Path | None:
    """Return the database of an agent that runs on a configuration and stores elsewhere than that says."""
    places = (*PLACES, config.file.parent, config.store.path.parent)
    return next((db for db in _running(places) if str(config.file) in ask(db, "status")["configs"]), None)


def _running(places: Iterable[Path]) -> list[Path]:
    """Return the databases in folders whose agent answers."""
    found = [sock.with_suffix("") for place in places for sock in sorted(place.glob("*.sock"))]
    return [db for db in found if _answers(db)]


def _only_one() -> Path:
    running = _running(PLACES)
    if not running:
        raise StoreError.at("deltak", "no agent runs here", "name its configuration or database, or start it")
    if len({_pid(db) for db in running}) > 1:
        names = ", ".join(map(str, running))
        raise UsageError.at("CONFIG|DB", f"several agents run: {names}", "name one")
    return running[0]


def _answers(db: Path) -> bool:
    try:
        _pid(db)
    except StoreError:
        return False
    return True


def _pid(db: Path) -> int:
    return int(ask(db, "ping")["pid"])


def asked(db: Path, command: str, **arguments: Any) -> Mapping[str, Any]:
    """Ask the agent that owns a database. Raises StoreError where none runs."""
    if not beside(db, ".sock").exists():
        raise StoreError.at(db, "no agent runs on it", _START)
    try:
        return ask(db, command, **arguments)
    except StoreError as error:
        if isinstance(error.__cause__, ConnectionRefusedError):
            raise StoreError.at(
                db, "no agent runs on it; the last one was killed", "start it again"
            ) from error
        raise
