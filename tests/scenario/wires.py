"""One scenario of one seed, played to an agent over several wires at once, and as a recording of the same
integers."""

import json
import os
import re
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from agent.evaluation.demo.bus import COARSE, Wire, write_config
from sim_bus.player import Player
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario

SAMPLES = 3000
LIMIT_S = 80.0
NEAR = 1e-9
"""Of a standard deviation: batches that arrive in other shapes may round differently."""
SYSTEM_CALLS = "write,writev,pwrite64,pwritev,pwritev2,sendto,sendmsg,sendmmsg,sendfile,splice"
_TCP = 'transport = "tcp"\nhost = "127.0.0.1"'
_RTU = 'transport = "rtu"\nbaudrate = 921600'
_BUSES = {
    "tcp": "modbus",
    "rtu": "modbus",
    "daemon": "can",
    "serial": "serial",
    "vcan": "can",
    "slcan": "can",
    "cobs": "serial",
}

ALARMS = (
    "SELECT * FROM v_alarms WHERE rig = ? AND NOT (kind = 'source' AND parameter = 'computing') ORDER BY id"
)
"""Five rigs in one process, played as fast as they are read, may be computed seconds behind."""
EXACT = (
    "parameter",
    "unit",
    "status",
    "reason",
    "reference",
    "window_s",
    "n_used",
    "n_missing",
    "span_s",
    "method",
)
ALARM = "raised", "cleared", "kind", "parameter", "priority", "state"


@dataclass(frozen=True)
class Outcome:
    """What the agent stored of one rig: rows and alarms as dicts, times in ns since the first row."""

    rows: Sequence[Mapping[str, Any]]
    alarms: Sequence[Mapping[str, Any]]


def configure(name: str, folder: Path, wire: Wire = COARSE, *, fast: bool = True) -> Path:
    """Write the demo's configuration for a wire, its rig called like the wire."""
    own = folder / name
    own.mkdir()
    path = write_config(_BUSES[name], wire, own, fast=fast).config
    text = path.read_text(encoding="utf-8").replace('name = "demo"', f'name = "{name}"')
    if name == "rtu":
        text = re.sub(r"port = \d+", 'port = "demo.tty"', text.replace(_TCP, _RTU))
    if name == "slcan":
        text = re.sub(r'interface = "socketcand"\nhost = .*\nport = \d+', 'interface = "slcan"', text)
        text = text.replace('channel = "vcan0"', 'channel = "demo.tty"')
    if name == "cobs":
        assert 'sync = "AA55"' in text
        text = text.replace('sync = "AA55"', 'framing = "cobs"')
    path.write_text(f"{text}\n[agent]\nworkers = 1\n", encoding="utf-8")  # fewer processes to trace
    return path


@contextmanager
def devices(config: Path, scenario: str = "default") -> Iterator[Player]:
    """Play the devices of a configuration as fast as they are read; the truth goes to truth.npz beside it."""
    player = Player(
        read_rig(config), load_scenario(scenario, {}), fast=True, truth=config.with_name("truth.npz")
    )
    player.start()
    try:
        yield player
    finally:
        player.finish()


def agent(configs: Sequence[Path], db: Path, trace: Path | None = None) -> list[str]:
    """Return the command that runs the agent, its writes traced by the kernel if a file for them is named."""
    command = [sys.executable, "-m", "agent", "run", *map(str, configs), "--db", str(db), "--json"]
    if trace is None:
        return command
    # -D: the agent stays a child of the one who starts it, and gets its signals
    return ["strace", "-D", "-f", "--seccomp-bpf", "-qq", "-e", f"trace={SYSTEM_CALLS}", "-e", "signal=none",
            "-yy", "-xx", "-s", "4096", "-o", str(trace), *command]  # fmt: skip


def run(
    configs: Sequence[Path], db: Path, trace: Path | None = None, played: Sequence[Path] = ()
) -> dict[str, Any]:
    """Play configurations (`played` where the agent's are other ones) to one agent; return its document at
    the end."""
    with ExitStack() as stack:
        for config in played or configs:
            stack.enter_context(devices(config))
        process = stack.enter_context(started(agent(configs, db, trace)))
        await_rows(process, db, {config.parent.name for config in configs})
        process.terminate()
        out, err = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, err
    document: dict[str, Any] = json.loads(out)
    return document


@contextmanager
def started(command: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def await_rows(process: subprocess.Popen[str], db: Path, rigs: set[str], rows: int = SAMPLES // 50) -> None:
    """Return when each rig has so many rows of each parameter."""
    deadline = time.monotonic() + LIMIT_S
    while (found := stored(db)).keys() < rigs or min(found.values()) < 4 * rows:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, f"after {LIMIT_S} s: {found} of {4 * rows} rows"
        time.sleep(0.05)


def stored(db: Path) -> dict[str, int]:
    """Return how many rows each rig has by now."""
    if not db.exists():
        return {}
    with closing(opened(db)) as connection:
        try:
            return dict(map(tuple, connection.execute("SELECT rig, count(*) FROM v_estimates GROUP BY rig")))
        except sqlite3.OperationalError:
            return {}  # the file is being made


def opened(db: Path) -> sqlite3.Connection:
    """Open the agent's database as any reader may; rows come by column name."""
    connection = sqlite3.connect(f"file:{db}?mode=ro", uri=True)
    connection.row_factory = sqlite3.Row
    return connection


def outcome(db: Path, rig: str) -> Outcome:
    """Read what is stored of one rig."""
    with closing(opened(db)) as connection:
        query = "SELECT * FROM v_estimates WHERE rig = ? ORDER BY t_ns, parameter"
        rows = [dict(row) for row in connection.execute(query, (rig,))]
        alarms = [dict(row) for row in connection.execute(ALARMS, (rig,))]
    origin = rows[0]["t_ns"]
    since = {None: None} | {row["time"]: row["t_ns"] - origin for row in rows}
    for row in rows:
        row["t_ns"] -= origin
    for alarm in alarms:
        alarm |= {"raised": since[alarm["raised_at"]], "cleared": since[alarm["cleared_at"]]}
    return Outcome(rows, alarms)


def assert_same(one: Outcome, other: Outcome, near: float) -> None:
    """Times, statuses and alarms are equal, values and deviations within `near` of the standard deviation."""
    assert [exact(row) for row in one.rows] == [exact(row) for row in other.rows]
    for here, there in zip(one.rows, other.rows, strict=True):
        sd = there["sd"]
        for key in ("value", "sd", "held", "lower", "upper"):
            assert (here[key] is None) == (there[key] is None), (key, here, there)
            assert sd is None or here[key] is None or abs(here[key] - there[key]) <= near * sd, (
                key,
                here,
                there,
            )
    assert [moment(alarm) for alarm in one.alarms] == [moment(alarm) for alarm in other.alarms]


def exact(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return (row["t_ns"], *(row[key] for key in EXACT))


def moment(alarm: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(alarm[key] for key in ALARM)


def integers(truth: Path, wire: Wire) -> np.ndarray:
    """Return what went over the wire (n, 3) as the truth file's readings, in steps."""
    with np.load(truth) as played:
        assert played["channel_names"].tolist() == ["force", "x1", "x2"]
        steps = np.array([float(wire.force_step), float(wire.length_step), float(wire.length_step)])
        limit = 2.0 ** (wire.bits - 1)
        return np.clip(np.rint(played["readings"] / steps), -limit, limit - 1)


def write_recording(path: Path, numbers: np.ndarray, wire: Wire) -> None:
    """Write the integers as a CSV recording in N and m, each value with the digits that give it back."""
    steps = (float(wire.force_step), float(wire.length_step), float(wire.length_step))
    lines = ["t,force,x1,x2"]
    for number, row in enumerate(numbers.tolist()):
        cells = [repr(cell * step) for cell, step in zip(row, steps, strict=True)]
        lines.append(",".join([f"{number // 1000}.{number % 1000:03d}", *cells]))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def replayed(
    config: Path, recording: Path, db: Path, environment: Mapping[str, str] = MappingProxyType({})
) -> Outcome:
    """Replay a recording by the command and read what it stored."""
    command = [
        sys.executable,
        "-m",
        "agent",
        "replay",
        str(config),
        str(recording),
        "--db",
        str(db),
        "--json",
    ]
    subprocess.run(command, check=True, capture_output=True, env=os.environ | environment, timeout=LIMIT_S)
    return outcome(db, config.parent.name)
