"""Which agent a command means: named by a database, a configuration, a folder of them, or the only one."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agent.config import files_of, load
from agent.errors import StoreError, UsageError
from agent.storage.database.files import beside
from agent.storage.write.command_socket import ask

PLACES = (Path(), Path("/var/lib/deltak"))
"""Where databases are looked for that nobody names: here, and where the service keeps them."""


def database_of(named: Path | None) -> Path:
    """Return the database whose socket is to be asked.

    Raises ConfigError for a configuration with faults, StoreError where no agent runs, UsageError where
    several do.
    """
    if named is None:
        return _only_one()
    if named.suffix == ".toml" or named.is_dir():
        return load(files_of([named])[0]).store.path
    return named


def _only_one() -> Path:
    found = [sock.with_suffix("") for place in PLACES for sock in sorted(place.glob("*.sock"))]
    running = [db for db in found if _answers(db)]
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
        raise StoreError.at(str(db), "no agent runs on it", "start it: deltak run, or systemctl start deltak")
    try:
        return ask(db, command, **arguments)
    except StoreError as error:
        if isinstance(error.__cause__, ConnectionRefusedError):
            raise StoreError.at(
                str(db), "no agent runs on it; the last one was killed", "start it again"
            ) from error
        raise
