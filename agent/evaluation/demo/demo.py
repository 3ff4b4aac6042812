"""`deltak demo`: a simulated device and the agent as two processes on a real local bus, held against truth.

This process starts both, waits, and compares afterwards; only it reads what the device played. Device and
agent share the bus and the configuration.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

from agent.config import RigConfig, load
from agent.errors import AgentError, BusError, Fault, StoreError, UsageError
from agent.evaluation.demo.bus import COARSE, FINE, RIGS, TWO_MASSES, write_config
from agent.evaluation.demo.truth import Truth, alarm_delays, read_truth, segments
from agent.evaluation.tuning import GRACE_S, STALL_S
from agent.storage.read import queries


def demo(
    *, bus: str, scenario: str | None, fast: bool, db: Path | None, rig: str = "two-mass"
) -> dict[str, Any]:
    """Run the demo; return the document of CONTRACT section 8.

    Without db the database is left in a folder of its own.

    Raises what the process says that fails, by its exit code: UsageError, StoreError, else BusError.
    """
    played = RIGS[rig]
    name = scenario or ("random" if "DELTAK_SEED" in os.environ and played is TWO_MASSES else played.scenario)
    with (
        TemporaryDirectory(prefix="deltak-demo-", ignore_cleanup_errors=True) as folder,
        _database(db) as database,
    ):
        made = write_config(bus, FINE if name == "paper" else COARSE, Path(folder), fast=fast, rig=played)
        sys.stderr.write(f"bus: {made.words}\n")
        document = _played(made.config, name, database, fast=fast)
    return document | {"bus": made.words, "scenario": name, "db": str(database)}


@contextmanager
def _database(db: Path | None) -> Iterator[Path]:
    """Give the file to write: where none is named one in a new folder, gone again where the demo fails."""
    if db is not None:
        yield db.absolute()
        return
    folder = Path(mkdtemp(prefix="deltak-"))
    try:
        yield folder / "demo.db"
    except BaseException:
        rmtree(folder)
        raise


def _played(made: Path, scenario: str, database: Path, *, fast: bool) -> dict[str, Any]:
    """Play a scenario to the agent and compare; the truth lies beside the configuration."""
    config = load(made)
    truth_file = made.with_name("truth.npz")
    with ExitStack() as stack:
        device = stack.enter_context(_process(_sim(made, scenario, truth_file, fast=fast), wait_for="ready"))
        agent = stack.enter_context(
            _process(_deltak("run", str(made), "--db", str(database), "--json", "--kind", "demo"))
        )
        processes = {"the simulated device": device, "the agent": agent}
        _await_rows(database, config.estimator.estimate[0], _rows_expected(config), processes)
        document = _ended(agent)
        _end(device)
    return document | _compared(config, read_truth(truth_file), document, database)


def _deltak(*args: str) -> list[str]:
    return [sys.executable, "-m", "agent.cli.demo_child", str(os.getpid()), *args]


def _sim(config: Path, scenario: str, truth: Path, *, fast: bool) -> list[str]:
    command = _deltak("sim", str(config), "--scenario", scenario, "--truth", str(truth), "--json")
    return [*command, "--fast"] if fast else command


@contextmanager
def _process(command: list[str], wait_for: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """Start a process and, where asked, wait for a line of its output; it is ended whatever happens."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
    try:
        if wait_for is not None:
            _await_line(process, wait_for)
        yield process
    finally:
        _put_away(process)


def _put_away(process: subprocess.Popen[str]) -> None:
    """End a process as its user would, and by force where that takes too long."""
    process.terminate()
    with suppress(subprocess.TimeoutExpired):
        process.wait(GRACE_S)
    process.kill()
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _await_line(process: subprocess.Popen[str], line: str) -> None:
    said = process.stdout.readline().strip() if process.stdout is not None else ""
    if said != line:
        raise _failed("the simulated device", process.wait(GRACE_S), said)


def _failed(who: str, code: int, said: str) -> AgentError:
    """Return what a process that ended by itself makes of the demo.

    It has said on stderr what was wrong, and in the document on its stdout, whose faults are told as well.
    """
    kind = {UsageError.exit_code: UsageError, StoreError.exit_code: StoreError}.get(code, BusError)
    error = kind.at("demo", f"{who} ended early (exit code {code})", "see its message above")
    error.causes = _faults_in(said)
    return error


def _faults_in(said: str) -> tuple[Fault, ...]:
    """Return the faults of a document on a process's stdout; none where it was killed before it wrote one."""
    try:
        return tuple(Fault(**fault) for fault in json.loads(said)["errors"])
    except (ValueError, TypeError, KeyError):
        return ()


def _rest_of(process: subprocess.Popen[str]) -> str:
    return "" if process.stdout is None else process.stdout.read()


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


def _await_rows(db: Path, parameter: str, rows: int, processes: Mapping[str, subprocess.Popen[str]]) -> None:
    """Wait until the database holds that many rows of the newest run, or nothing comes any more."""
    seen = 0
    changed = time.monotonic()
    while seen < rows and time.monotonic() - changed < STALL_S:
        for who, process in processes.items():
            if process.poll() is not None:
                raise _failed(who, process.returncode, _rest_of(process))
        now = _rows_there(db, parameter)
        seen, changed = (now, time.monotonic()) if now != seen else (seen, changed)
        time.sleep(0.05)


def _ended(agent: subprocess.Popen[str]) -> dict[str, Any]:
    agent.terminate()
    out, _ = agent.communicate(timeout=GRACE_S)
    if agent.returncode != 0:
        raise _failed("the agent", agent.returncode, out)
    document: dict[str, Any] = json.loads(out)
    return document


def _end(device: subprocess.Popen[str]) -> None:
    device.terminate()
    device.wait(timeout=GRACE_S)


def _compared(config: RigConfig, truth: Truth, document: Mapping[str, Any], db: Path) -> dict[str, Any]:
    rows = [row for row in queries.estimates(db, config.rig.name) if row["run_id"] == document["run_id"]]
    return {
        "truth": segments(config, truth, rows),
        "alarm_delays": alarm_delays(config, truth, rows, document["alarms"]),
    }
