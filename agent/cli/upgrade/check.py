"""`deltak upgrade --check`: what this version would do to databases and configurations; changes nothing."""

import os
import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent import __version__
from agent.cli.terminal.output import fault_document, print_table, show
from agent.cli.upgrade.copies import copies_of
from agent.config import files_of, load_many
from agent.errors import AgentError, ConfigError, Fault, StoreError
from agent.storage.database.connect import connect_reader
from agent.storage.database.files import Kind, beside, check_place, kind_of, refuse
from agent.storage.database.schema import SCHEMA_VERSION, steps_from
from agent.storage.tuning import WAL_BOUND

CONFIGURATIONS = Path("/etc/deltak")
DATABASES = Path("/var/lib/deltak")


@dataclass(frozen=True, slots=True)
class Places:
    """Configurations by agent (each a file, or a folder of files that one agent runs on), and databases."""

    configs: tuple[Path, ...]
    databases: tuple[Path, ...]


def places_of(named: Sequence[Path]) -> Places:
    """Return what paths name (*.toml and folders are configurations); without any what the services have."""
    if not named:
        return _of_services()
    configs = tuple(path for path in named if path.suffix == ".toml" or path.is_dir())
    return Places(configs, tuple(path for path in named if path not in configs))


def _of_services() -> Places:
    folder = CONFIGURATIONS / "conf.d"
    shared = (folder,) if any(folder.glob("*.toml")) else ()
    return Places((*shared, *sorted(CONFIGURATIONS.glob("*.toml"))), tuple(sorted(DATABASES.glob("*.db"))))


Document = Mapping[str, Any]
READS_ALL = "the former version reads it as it is"
COPY = "the former version does not read it afterwards; `upgrade --to` keeps a copy to go back to"


def check(named: Sequence[Path]) -> Document:
    """Return the document of `deltak upgrade --check`; `errors` holds every reason not to upgrade."""
    places = places_of(named)
    configs = [_config(path) for path in places.configs]
    databases = [_database(path) for path in _databases(places, configs)]
    errors = [error for row in (*configs, *databases) for error in row["errors"]]
    return {
        "version": __version__, "schema_version": SCHEMA_VERSION, "ok": not errors, "errors": errors,
        "configs": [{key: value for key, value in row.items() if key != "databases"} for row in configs],
        "databases": databases,
    }  # fmt: skip


def exit_code(document: Document) -> int:
    """Return 0 where nothing speaks against the upgrade, 2 for a configuration, 3 for a database."""
    if any(row["errors"] for row in document["configs"]):
        return ConfigError.exit_code
    return 0 if document["ok"] else StoreError.exit_code


def print_check(document: Document) -> None:
    """Print what would be done, a line for each file."""
    show(f"deltak {document['version']}, databases of version {document['schema_version']}")
    rows = [(row["file"], "not valid" if row["errors"] else "valid", "", "") for row in document["configs"]]
    rows += [_row(row) for row in document["databases"]]
    print_table("", ("file", "what would be done", "MB wanted, free", "to go back"), rows)


def _row(row: Document) -> tuple[str, str, str, str]:
    done = {
        "none": f"nothing: version {row['version']} already",
        "migrate": f"brought from version {row['version']} to {SCHEMA_VERSION}",
        "create": "made at the start",
        "refuse": "refused",
    }[row["action"]]
    room = f"{row['needs_bytes'] / 1e6:.0f}, {row['free_bytes'] / 1e6:.0f}"
    return row["db"], done, room, row["back"]


def _config(path: Path) -> dict[str, Any]:
    """Return whether the configuration of one agent is valid, and its databases."""
    try:
        configs = load_many(files_of([path]))
    except AgentError as error:
        return {
            "file": str(path),
            "errors": [fault_document(fault) for fault in error.faults],
            "databases": (),
        }
    return {"file": str(path), "errors": [], "databases": tuple(config.store.path for config in configs)}


def _databases(places: Places, configs: Sequence[Document]) -> list[Path]:
    """Return the databases once each: those that are named, and of configurations those that are there."""
    configured = [path for row in configs for path in row["databases"] if path.exists()]
    return list(dict.fromkeys([*places.databases, *configured]))


def _database(path: Path) -> dict[str, Any]:
    """Return what would be done with one database."""
    found: dict[str, Any] = {
        "db": str(path), "version": None, "action": "refuse", "steps": [], "needs_bytes": 0, "free_bytes": 0,
        "back": "", "copies": [str(copy) for copy in copies_of(path)], "errors": [],
    }  # fmt: skip
    try:
        found |= _plan(path)
    except (AgentError, sqlite3.Error, OSError) as error:
        faults = error.faults if isinstance(error, AgentError) else (Fault(str(path), str(error)),)
        found["errors"] = [fault_document(fault) for fault in faults]
    return found


def _plan(path: Path) -> dict[str, Any]:
    """Return the parts of a database's document that are known once it can be read. Raises StoreError."""
    check_place(path)
    kind = kind_of(path)
    refuse(path, kind)
    if not path.exists():
        raise StoreError.at(path, "there is no such database", "give the path that the agent writes to")
    if kind is Kind.MISSING:
        return {"action": "create", "free_bytes": _free(path), "needs_bytes": WAL_BOUND, "back": READS_ALL}
    version = _version(path)
    steps = steps_from(version)
    needs = WAL_BOUND + (_size(path) if steps else 0)
    return {
        "version": version, "action": "migrate" if steps else "none", "steps": steps, "needs_bytes": needs,
        "free_bytes": _free(path), "back": COPY if steps else READS_ALL, "errors": _no_room(path, needs),
    }  # fmt: skip


def _version(path: Path) -> int:
    """Return a file's version; one of this version is looked at as every reader does. Raises StoreError."""
    version = int.from_bytes(_head(path)[62:64], "big")
    if version == SCHEMA_VERSION:
        connect_reader(path).close()
        return version
    # a file that nobody has open has no log; immutable: SQLite would leave an empty one beside it
    mode = "mode=ro" if beside(path, "-wal").exists() else "mode=ro&immutable=1"
    with closing(sqlite3.connect(f"{path.absolute().as_uri()}?{mode}", uri=True)) as connection:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    return version


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(64)


def _no_room(path: Path, needs: int) -> list[dict[str, str]]:
    free = _free(path)
    if free >= needs:
        return []
    what = f"{needs / 1e6:.0f} MB are wanted beside it and {free / 1e6:.0f} MB are free"
    return [fault_document(Fault(str(path), what, "free the disk, or `deltak db compact` first"))]


def _size(path: Path) -> int:
    log = beside(path, "-wal")
    return path.stat().st_size + (log.stat().st_size if log.exists() else 0)


def _free(path: Path) -> int:
    disk = os.statvfs(path.parent)
    return disk.f_bavail * disk.f_frsize
