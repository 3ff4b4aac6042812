"""An agent as a process of its own, and what it left behind."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from tests.ports import free_port
from tests.sim.rigs import ROOT

LIMIT_S = 40.0
EXAMPLES = ROOT / "deploy" / "examples"


class Agent:
    """`deltak run` in a process of its own."""

    def __init__(self, configs: Sequence[Path], *options: str, wrapper: Sequence[str] = ()) -> None:
        command = [*wrapper, sys.executable, "-m", "agent", "run", *map(str, configs), "--json", *options]
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=os.environ | {"DELTAK_SEED": ""}, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )  # fmt: skip

    def end(self, number: int | None = None) -> int:
        """Send a signal, if any, and return the exit code once it is there."""
        if number is not None:
            self.process.send_signal(number)
        self.out, self.err = self.process.communicate(timeout=LIMIT_S)
        return self.process.returncode

    def document(self) -> dict[str, Any]:
        """Stop by SIGTERM and return the JSON document."""
        code = self.end(signal.SIGTERM)
        assert code == 0, self.err
        found: dict[str, Any] = json.loads(self.out)
        return found


@contextmanager
def agent(*configs: Path, options: Sequence[str] = (), wrapper: Sequence[str] = ()) -> Iterator[Agent]:
    """Run an agent and end it in any case."""
    running = Agent(configs, *options, wrapper=wrapper)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.process.kill()
            running.process.communicate()


def wait_until(condition: Callable[[], bool], what: str, limit_s: float = LIMIT_S) -> None:
    """Return when a condition holds; fail after a while."""
    deadline, pause = time.monotonic() + limit_s, threading.Event()
    while not condition():
        assert time.monotonic() < deadline, f"not within {limit_s:g} s: {what}"
        pause.wait(0.05)


def rows(db: Path, query: str, *values: object) -> list[tuple[Any, ...]]:
    """Ask a database that an agent may be writing to; nothing while it is not there."""
    if not db.exists():
        return []
    with closing(sqlite3.connect(f"file:{db}?mode=ro", uri=True, timeout=5.0)) as connection:
        return connection.execute(query, values).fetchall()


def hops(db: Path, rig: str | None = None) -> int:
    """Instants for which estimates are stored."""
    where = "" if rig is None else "WHERE rig = ?"
    found = rows(db, f"SELECT count(DISTINCT t_ns) FROM v_estimates {where}", *([rig] if rig else []))
    return int(found[0][0]) if found else 0


def counts(db: Path) -> dict[str, int]:
    """Rows of every table."""
    tables = [
        name for (name,) in rows(db, "SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
    ]
    return {name: rows(db, f'SELECT count(*) FROM "{name}"')[0][0] for name in tables}


def example(name: str, folder: Path, **changes: str) -> Path:
    """Copy an example rig into a folder: on a free port, every row kept, text replaced as asked for."""
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    text = text.replace("port = 1502", f"port = {free_port()}").replace(
        "port = 29536", f"port = {free_port()}"
    )
    text = text.replace("every_s = 1.0", "every_s = 0")
    for old, new in changes.items():
        text = text.replace(f"{old} = ", f"{old} = {new}  # ")
    dbc = EXAMPLES / "two-mass-rig.dbc"
    (folder / dbc.name).write_bytes(dbc.read_bytes())
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path
