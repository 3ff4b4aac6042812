"""`deltak diag`: one archive with what support needs, and no secret in it."""

import gzip
import io
import json
import os
import platform
import sqlite3
import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, suppress
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from agent import __version__
from agent.cli.gateway.agent_of import asked, database_of
from agent.cli.gateway.redaction import Redaction
from agent.cli.terminal.output import json_ready, show
from agent.cli.tuning import DIAG_BYTES, DIAG_S
from agent.config import files_of
from agent.errors import AgentError, RecordingError, StoreError, UsageError
from agent.recording import blocks
from agent.recording.setup import FOLDER
from agent.storage.database.connect import connect_reader
from agent.storage.database.files import Kind, check_place, kind_of, opened, refuse
from agent.text import counted


def newest_samples(db: Path) -> Iterator[tuple[str, bytes]]:
    """Yield name and content of the newest minute of every source that is recorded; nothing where none is."""
    folder = db.with_name(db.name + FOLDER)
    newest: dict[str, Path] = {}
    for file in sorted(folder.glob("*")) if folder.is_dir() else ():
        if file.suffix in {blocks.SUFFIX, ".log"}:
            newest[file.name.rpartition("-")[0]] = file
    for file in newest.values():
        with suppress(OSError, RecordingError, ValueError):
            yield file.name, _blocks(file) if file.suffix == blocks.SUFFIX else _lines(file)


def _blocks(file: Path) -> bytes:
    kept = list(blocks.read_blocks(file))
    newest = kept[-1].arrival_ns if kept else 0
    with file.open("rb") as stream:
        header = blocks.read_header(stream, file)
    fresh = [block for block in kept if newest - block.arrival_ns <= DIAG_S * 1e9]
    return blocks.encode_header(header) + b"".join(map(blocks.encode_block, fresh))


def _lines(file: Path) -> bytes:
    """Return the last minute of a candump log: lines that begin with (seconds)."""
    with file.open("rb") as stream:
        stream.seek(max(0, file.stat().st_size - DIAG_BYTES))
        lines = [line for line in stream.read().splitlines(keepends=True) if line.startswith(b"(")]
    until = _seconds(lines[-1]) if lines else 0.0
    return b"".join(line for line in lines if until - _seconds(line) <= DIAG_S)


def _seconds(line: bytes) -> float:
    return float(line[1 : line.index(b")")])


Document = Mapping[str, Any]
_QUERIES = {
    "meta": "SELECT * FROM v_meta",
    "runs": "SELECT * FROM v_runs ORDER BY run_id DESC LIMIT 20",
    "ledgers": "SELECT * FROM v_health ORDER BY t_ns DESC LIMIT 100",
    "ledger_reasons": "SELECT * FROM v_health_reasons ORDER BY t_ns DESC LIMIT 200",
    "events": "SELECT * FROM v_events ORDER BY t_ns DESC LIMIT 500",
    "alarms": "SELECT * FROM v_alarms ORDER BY id DESC LIMIT 500",
}
_SCHEMA = "SELECT type, name, sql FROM sqlite_master ORDER BY type, name"


def diag(named: Path | None, to: Path) -> Document:
    """Write the bundle of an agent, or of a database and configuration whose agent does not run.

    Raises StoreError for a path where nothing is or what was never a database, UsageError where the bundle
    cannot be written; whatever else is not there is said in the bundle.
    """
    db = database_of(named)
    if named == db:
        _need_database(db)
    status, why = _answer(db, "status")
    configs = _configs(named, status)
    redaction = Redaction(configs)
    parts: dict[str, Callable[[], bytes]] = {
        "versions.json": lambda: _json(_versions()),
        "status.json": lambda: _json(status or {"error": why}),
        "log.txt": lambda: "\n".join((_answer(db, "log")[0] or {}).get("lines", [])).encode(),
    }
    parts |= {f"config/{n}-{file.name}": file.read_bytes for n, file in enumerate(configs)}
    parts |= {f"database/{name}.json": _query(db, query) for name, query in _QUERIES.items()}
    parts["database/schema.json"] = _query(db, _SCHEMA, any_schema=True)
    texts = {name: redaction.cleaned(_made(make)) for name, make in parts.items()}
    samples = {f"samples/{name}": content for name, content in newest_samples(db)}
    try:
        _write(to, texts | samples)
    except OSError as error:
        advice = "give a file in a folder that you may write to"
        raise UsageError.at("--to", f"{to}: {error.strerror or error}", advice) from error
    return {
        "file": str(to),
        "bytes": to.stat().st_size,
        "parts": sorted(texts | samples),
        "agent": status is not None,
    }


def _need_database(db: Path) -> None:
    if not os.path.lexists(db):
        raise StoreError.at(db, "there is no such database", "give the path that the agent writes to")
    check_place(db)
    if kind_of(db) is Kind.FOREIGN:
        refuse(db, Kind.FOREIGN)


def print_diag(found: Document) -> None:
    """Say what was written."""
    running = "" if found["agent"] else "; no agent runs on it, so there is no status and no log"
    show(
        f"{found['file']}: {counted(len(found['parts']), 'part')}, {counted(found['bytes'], 'byte')}{running}"
    )


def _answer(db: Path, command: str) -> tuple[Document | None, str]:
    try:
        return asked(db, command), ""
    except AgentError as error:
        return None, str(error)


def _configs(named: Path | None, status: Document | None) -> list[Path]:
    """Return the files of configuration: those that the agent runs on, else those that are named."""
    if status is not None:
        return [Path(file) for file in status["configs"]]
    return files_of([named]) if named is not None and (named.suffix == ".toml" or named.is_dir()) else []


def _versions() -> Document:
    packages = {dist.name: dist.version for dist in distributions()}
    return {
        "deltak": __version__, "python": platform.python_version(), "sqlite": sqlite3.sqlite_version,
        "system": platform.platform(), "packages": dict(sorted(packages.items())),
    }  # fmt: skip


def _query(db: Path, query: str, *, any_schema: bool = False) -> Callable[[], bytes]:
    """Return what makes a part; any_schema: where a foreign schema does no harm, since no view is asked."""

    def rows() -> bytes:
        with closing(connect_reader(db, any_schema=any_schema)) as connection:
            cursor = connection.execute(query)
            names = [column[0] for column in cursor.description]
            return _json([dict(zip(names, row, strict=True)) for row in cursor])

    return rows


def _made(make: Callable[[], bytes]) -> bytes:
    """Return a part, or why there is none."""
    try:
        return make()
    except (AgentError, sqlite3.Error, OSError) as error:
        return f"not there: {error}\n".encode()


def _json(value: Any) -> bytes:
    return json.dumps(json_ready(value), indent=1, ensure_ascii=False).encode()


def _write(to: Path, parts: Mapping[str, bytes]) -> None:
    """Write the archive whole, readable by nobody else."""
    packed = io.BytesIO()
    with (
        gzip.GzipFile(fileobj=packed, mode="wb") as zipped,
        tarfile.open(fileobj=zipped, mode="w") as archive,
    ):
        for info, content in _members(parts):
            archive.addfile(info, io.BytesIO(content))
    with os.fdopen(opened(to, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "wb") as file:
        os.fchmod(file.fileno(), 0o600)
        file.write(packed.getvalue())


def _members(parts: Mapping[str, bytes]) -> Iterator[tuple[tarfile.TarInfo, bytes]]:
    for name, content in sorted(parts.items()):
        info = tarfile.TarInfo(f"deltak-diag/{name}")
        info.size = len(content)
        info.mode = 0o600
        yield info, content
