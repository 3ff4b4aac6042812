"""kill -9 of the whole agent while it listens to a bus. What was acknowledged is noted by the reader of its
output."""

import json
import os
import re
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.storage.database.connect import connect_reader
from agent.storage.database.files import beside
from agent.storage.database.verify import problems
from agent.storage.write.store import Store
from tests.figures import figure
from tests.peers import ROOT
from tests.scenario.live import example

STORED = re.compile(rb"stored in run (\d+): (\d+) instants up to (\d+), (\d+) steps of alarms")
LIMIT_S = 100.0
SLOWEST_START_S = 2.0
PARAMETERS = 4
QUIET = {r"(?m)^limit = .*": "limit = 1000.0"}
PROFILES: dict[str, dict[str, str]] = {
    "defaults": QUIET | {"every_s = 0": "every_s = 1.0"},
    "all rows": QUIET,
    "alarms": {},
}
SCENARIO = """
[[force]]
kind = "random"
rms = 5.0
[noise]
displacement = 1e-6
"""
CHANGE_S = 0.7
CHANGES = 3000


def scenario(folder: Path) -> Path:
    """Write a scenario in which an alarm is raised and cleared again and again."""
    path = folder / "flutter.toml"
    changes = (
        f"[[change]]\nat_s = {CHANGE_S * i:.1f}\ndelta = {{ k1 = {25.0 * (i % 2)} }}\n"
        for i in range(CHANGES)
    )
    path.write_text(SCENARIO + "".join(changes), encoding="utf-8")
    return path


@dataclass
class Told:
    """What the reader of the agents' output noted over all lives on one database."""

    instants: Counter[int] = field(default_factory=Counter)
    newest: dict[int, int] = field(default_factory=dict)
    steps: int = 0

    def note(self, lines: list[bytes]) -> None:
        for line in lines:
            found = STORED.search(line)
            if found is not None:
                run, instants, newest, steps = map(int, found.groups())
                self.instants[run] += instants
                self.newest[run] = max(newest, self.newest.get(run, 0))
                self.steps += steps


class Output:
    """Lines of a process, read as they come."""

    def __init__(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdout is not None
        self._descriptor = process.stdout.fileno()
        self._octets = b""

    @property
    def lines(self) -> list[bytes]:
        """Return the whole lines so far; one that a kill cut was not told."""
        return self._octets.split(b"\n")[:-1]

    def read(self, until: Callable[[list[bytes]], bool], limit_s: float = LIMIT_S) -> bool:
        end = time.monotonic() + limit_s
        while not until(self.lines):
            left = end - time.monotonic()
            if left <= 0 or not select.select([self._descriptor], [], [], left)[0]:
                return False
            more = os.read(self._descriptor, 65536)
            if not more:
                return False
            self._octets += more
        return True

    def forget(self) -> None:
        self._octets = b""


def has(word: bytes) -> Callable[[list[bytes]], bool]:
    return lambda lines: any(word in line for line in lines)


def tells_rows(lines: list[bytes]) -> bool:
    """Whether rows were acknowledged: what comes before them holds none."""
    return any(int(found[2]) for line in lines if (found := STORED.search(line)) is not None)


def never(_: list[bytes]) -> bool:
    return False


def arguments(config: Path, db: Path) -> list[str]:
    return ["-v", "run", str(config), "--db", str(db)]


class Cradle:
    """Agents, one after another, forked from a process that has all imported."""

    def __init__(self) -> None:
        command = [sys.executable, "-m", "tests.storage.cradle"]
        self._process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            bufsize=0,
        )
        self._output = Output(self._process)

    def live(self, command: list[str], after_s: float) -> list[bytes]:
        """Let an agent live until some time after its first acknowledged rows; kill it, return what it had
        told."""
        assert self._process.stdin is not None
        self._output.forget()
        self._process.stdin.write(json.dumps(command).encode() + b"\n")
        assert self._output.read(tells_rows), self._output.lines
        self._output.read(never, after_s)
        os.kill(int(self._output.lines[0].split()[1]), signal.SIGKILL)
        assert self._output.read(lambda lines: lines[-1:] == [b"dead"] or has(b"dead")(lines))
        return self._output.lines

    def end(self) -> None:
        self._process.communicate()


def worked_s(pid: int) -> float:
    """Return the processor's time that a process has had, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def live_from_nothing(command: list[str]) -> tuple[list[bytes], float, float]:
    """As `Cradle.live`, of an agent started as users do; also how long its first sample took, and of that
    work, s."""
    started = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "agent", *command],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        bufsize=0,
    )
    output = Output(process)
    assert output.read(has(b"delivers samples")), output.lines
    first, work = time.monotonic() - started, worked_s(process.pid)
    assert output.read(has(b"stored in run")), output.lines
    process.kill()
    process.wait()
    output.read(never)
    assert process.stdout is not None
    process.stdout.close()
    return output.lines, first, work


def lost(db: Path, reported: Told) -> int:
    """Return how many acknowledged rows a reader of the file misses."""
    reader = connect_reader(db)
    missing = 0
    query = (
        "SELECT count(*), sum((SELECT count(*) FROM estimates e "
        "WHERE e.seq BETWEEN h.seq << 10 AND (h.seq << 10) + 1023)) "
        "FROM hops h WHERE h.run_id = ? AND h.span = 0 AND h.t_ns <= ?"
    )
    for run, instants in reported.instants.items():
        found, cells = reader.execute(query, (run, reported.newest[run])).fetchone()
        missing += max(0, instants - found) + max(0, PARAMETERS * instants - (cells or 0))
    missing += max(0, reported.steps - reader.execute("SELECT count(*) FROM alarm_events").fetchone()[0])
    reader.close()
    return missing


@pytest.fixture(scope="module")
def bus(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A played rig that samples at 1 kHz; the path of the configuration that reads it."""
    folder = tmp_path_factory.mktemp("bus")
    config = example("modbus", folder)
    command = [sys.executable, "-m", "sim_bus", config, "--scenario", scenario(folder)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE)
    assert Output(process).read(has(b"ready"))
    yield config
    process.terminate()
    process.communicate(timeout=LIMIT_S)


def own_config(bus: Path, profile: str) -> Path:
    """Write the configuration of a profile, for the same bus."""
    text = bus.read_text(encoding="utf-8")
    for old, new in PROFILES[profile].items():
        text = re.sub(old, new, text)
    path = bus.with_name(f"{profile}.toml".replace(" ", "-"))
    path.write_text(text, encoding="utf-8")
    return path


def lives(bus: Path, profile: str, kills: int, seed: int) -> Told:
    """Kill agents on one database, one after another."""
    config, rng, reported = own_config(bus, profile), np.random.default_rng(seed), Told()
    db, cradle = config.with_suffix(".db"), Cradle()
    for number in range(kills):
        reported.note(cradle.live(arguments(config, db), float(rng.uniform(0.0, 0.8))))
        assert lost(db, reported) == 0, f"{profile}, life {number}"
    cradle.end()
    with Store.open(db) as store:
        assert store.recovery is None
        assert problems(store.connection) == []
    return reported


@pytest.mark.realtime
@pytest.mark.parametrize(
    "kills", [(4, 7, 7), pytest.param((66, 67, 67), marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_kill_of_the_agent_at_any_moment_loses_nothing_acknowledged(
    bus: Path, kills: tuple[int, ...], rng: np.random.Generator
) -> None:
    seeds = rng.integers(2**31, size=len(PROFILES)).tolist()
    with ThreadPoolExecutor() as pool:
        done = list(pool.map(lives, [bus] * len(PROFILES), PROFILES, kills, seeds))
    reported = dict(zip(PROFILES, done, strict=True))
    words = ", ".join(
        f"{name} {sum(t.instants.values())} instants, {t.steps} steps" for name, t in reported.items()
    )
    figure(f"kill -9 of the agent: {sum(kills)} kills, nothing of what was acknowledged lost ({words})")
    assert min(sum(t.instants.values()) for t in reported.values()) >= kills[0]
    assert reported["alarms"].steps > 0


@pytest.mark.realtime
@pytest.mark.parametrize("starts", [2, pytest.param(20, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])])
def test_agent_has_its_first_sample_two_seconds_after_a_kill(bus: Path, starts: int) -> None:
    """Started as users do, on the file that the agent before it left when it was killed."""
    config, reported = own_config(bus, "all rows"), Told()
    took, worked = [], []
    db = config.with_name("starts.db")
    for _ in range(starts):
        lines, first_s, work_s = live_from_nothing(arguments(config, db))
        reported.note(lines)
        took.append(first_s)
        worked.append(work_s)
        assert lost(db, reported) == 0
    alone = os.getloadavg()[0] < (os.cpu_count() or 1)
    figure(
        f"first sample after the start of the agent, {starts} starts after kill -9: "
        f"{np.median(took):.2f} s (2 s), "
        f"{np.median(worked):.2f} s of it work{'' if alone else '; the machine was busy with other things'}"
    )
    assert np.median(worked) <= SLOWEST_START_S
    assert np.median(took) <= SLOWEST_START_S or not alone


@pytest.mark.realtime
def test_commands_on_the_file_of_a_running_agent_go_through_it_or_are_refused(
    bus: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config = own_config(bus, "all rows")
    db = config.with_name("held.db")
    process = subprocess.Popen(
        [sys.executable, "-m", "agent", *arguments(config, db)], cwd=ROOT, stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, bufsize=0,
    )  # fmt: skip
    output = Output(process)
    assert output.read(has(b"stored in run")), output.lines
    assert guarded(app, ["db", "compact", str(db), "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["bytes_after"] > 0
    assert guarded(app, ["db", "repair", str(db)]) == 0
    assert "sound" in capfd.readouterr().out
    recording = config.with_name("recording.csv")
    recording.write_text("t,force,x1,x2\n0,0,0,0\n0.001,0,0,0\n", encoding="utf-8")
    assert guarded(app, ["replay", str(config), str(recording), "--db", str(db)]) == 3
    assert f"process {process.pid} is writing to this database" in capfd.readouterr().err
    seen = len(output.lines)
    assert output.read(lambda lines: len(lines) > seen)
    process.terminate()
    assert process.wait(LIMIT_S) == 0
    assert process.stdout is not None
    process.stdout.close()
    assert guarded(app, ["db", "compact", str(db)]) == 0
    assert not beside(db, ".sock").exists()
