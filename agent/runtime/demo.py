"""`deltak demo`: a simulated device and the agent as two processes on a real local bus, held against the truth.

This process starts both, waits, and compares afterwards; only it reads what the device played. Device and agent share
the bus and the configuration.
"""

import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from agent.config import RigConfig, load
from agent.errors import BusError
from agent.runtime.demo_bus import COARSE, FINE, write_config
from agent.runtime.demo_truth import Truth, alarm_delays, read_truth, segments
from agent.storage import queries

READY_S = 30.0
STALL_S = 20.0
GRACE_S = 20.0

log = logging.getLogger(__name__)


def demo(*, bus: str, scenario: str | None, fast: bool, db: Path | None) -> dict[str, Any]:
    """Run the demo; return the document of CONTRACT section 8.

    Raises BusError when the bus cannot be made or one of the processes fails.
    """
    name = scenario or ("random" if "DELTAK_SEED" in os.environ else "default")
    folder = Path(tempfile.mkdtemp(prefix="deltak-demo-"))
    made = write_config(bus, FINE if name == "paper" else COARSE, folder, fast=fast)
    sys.stderr.write(f"bus: {made.words}; files in {folder}\n")
    config = load(made.config)
    database = (db or folder / "demo.db").absolute()
    truth_file = folder / "truth.npz"
    with ExitStack() as stack:
        device = stack.enter_context(_process(_sim(made.config, name, truth_file, fast=fast), wait_for="ready"))
        agent = stack.enter_context(_process(_run(made.config, database)))
        _await_rows(database, config.estimator.estimate[0], _rows_expected(config), (device, agent))
        document = _ended(agent)
        _end(device)
    return document | _compared(config, read_truth(truth_file), document, database) | {
        "bus": made.words, "scenario": name,
    }  # fmt: skip


def _deltak(*args: str) -> list[str]:
    return [sys.executable, "-m", "agent", *args]


def _sim(config: Path, scenario: str, truth: Path, *, fast: bool) -> list[str]:
    command = _deltak("sim", str(config), "--scenario", scenario, "--truth", str(truth))
    return [*command, "--fast"] if fast else command


def _run(config: Path, db: Path) -> list[str]:
    return _deltak("run", str(config), "--db", str(db), "--json", "--kind", "demo")


@contextmanager
def _process(command: list[str], wait_for: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """Start a process and, where asked, wait for a line of its output; it is ended whatever happens."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
    try:
        if wait_for is not None:
            _await_line(process, wait_for)
        yield process
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def _await_line(process: subprocess.Popen[str], line: str) -> None:
    said = process.stdout.readline().strip() if process.stdout is not None else ""
    if said != line:
        raise BusError.at("demo", f"the simulated device ended before it was {line}", "see its message above")


def _rows_expected(config: RigConfig) -> int:
    """Rows of each parameter that three seconds of samples give."""
    return round(3.0 / config.estimator.hop_s)


def _rows_there(db: Path, parameter: str) -> int:
    """Rows of one parameter that the newest run has stored."""
    if not db.exists() or not (runs := queries.runs(db)):
        return 0
    newest = max(run["run_id"] for run in runs)
    rows = queries.estimates(db)
    return sum(row["run_id"] == newest and row["parameter"] == parameter for row in rows)


def _await_rows(db: Path, parameter: str, rows: int, processes: tuple[subprocess.Popen[str], ...]) -> None:
    """Wait until the database holds that many rows of the newest run, or nothing comes any more."""
    seen, changed = 0, time.monotonic()
    while seen < rows and time.monotonic() - changed < STALL_S:
        for process in processes:
            if process.poll() is not None:
                raise BusError.at("demo", f"a process of the demo ended early (exit code {process.returncode})")
        now = _rows_there(db, parameter)
        seen, changed = (now, time.monotonic()) if now != seen else (seen, changed)
        time.sleep(0.05)


def _ended(agent: subprocess.Popen[str]) -> dict[str, Any]:
    agent.terminate()
    out, _ = agent.communicate(timeout=GRACE_S)
    if agent.returncode != 0:
        raise BusError.at("demo", f"the agent ended with exit code {agent.returncode}", "see its message above")
    document: dict[str, Any] = json.loads(out)
    return document


def _end(device: subprocess.Popen[str]) -> None:
    device.terminate()
    device.wait(timeout=GRACE_S)


def _compared(config: RigConfig, truth: Truth, document: Mapping[str, Any], db: Path) -> dict[str, Any]:
    rows = queries.estimates(db, config.rig.name)
    rows = [row for row in rows if row["run_id"] == document["run_id"]]
    return {
        "truth": segments(config, truth, rows),
        "alarm_delays": alarm_delays(config, truth, rows, document["alarms"]),
    }
