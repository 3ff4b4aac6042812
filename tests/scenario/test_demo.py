"""The demo: two processes, a bus between them, and the truth held against what was stored."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.storage.read import queries
from tests import peers
from tests.scenario.live import LIMIT_S, agent, example, hops, rows, wait_until
from tests.scenario.offline import SECOND, bounds, called_for, play
from tests.sim.rigs import ROOT, Simulator

pytestmark = pytest.mark.realtime

CALLED_FOR = [("B1", 1.0), ("B2", 1.0), ("k1", 0.0), ("k1", 2.0), ("k2", 0.0), ("k2", 2.0)]
ROWS = 60


def demo(*options: str, seed: int | None = None) -> dict[str, Any]:
    environment = {name: value for name, value in os.environ.items() if name != "DELTAK_SEED"}
    environment |= {} if seed is None else {"DELTAK_SEED": str(seed)}
    done = subprocess.run(
        [sys.executable, "-m", "agent", "demo", "--json", *options], cwd=ROOT, env=environment,
        capture_output=True,
        text=True, timeout=2 * LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def cells(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for segment in document["truth"]:
        for name, cell in segment["parameters"].items():
            yield f"{name} up to {segment['to_s']} s", cell


def assert_nothing_lost(document: dict[str, Any]) -> None:
    assert document["samples"] == {"received": 3000, "used": 3000, "rejected": {}, "dropped": {}, "gaps": 0}


@pytest.fixture(scope="module")
def default(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return demo("--db", str(tmp_path_factory.mktemp("demo") / "demo.db"))


def test_demo_document_is_complete_and_no_sample_is_lost(default: dict[str, Any]) -> None:
    keys = {"rig", "db", "run_id", "samples", "span_s", "windows", "estimates", "alarms", "seconds",
            "samples_per_s", "bus", "scenario", "truth", "alarm_delays"}  # fmt: skip
    assert keys <= default.keys()
    assert_nothing_lost(default)
    assert (default["windows"], default["span_s"]) == (ROWS, 3.0)
    assert [(s["from_s"], s["to_s"]) for s in default["truth"]] == [(0.0, 1.0), (1.0, 2.0), (2.0, 3.0)]


def test_demo_real_time_takes_as_long_as_its_samples_and_little_more(default: dict[str, Any]) -> None:
    assert 3.0 <= default["seconds"] <= 12.0


def test_demo_last_estimates_of_segments_are_within_3_sd_and_sd_near_the_bound(
    default: dict[str, Any],
) -> None:
    for where, cell in cells(default):
        assert abs(cell["estimate"] - cell["true"]) <= 3 * cell["sd"], where
        assert cell["sd"] <= 1.3 * cell["bound_sd"], where


def test_demo_true_values_are_those_of_the_schedule(default: dict[str, Any]) -> None:
    schedule = [(50, 150, 5, 5), (25, 100, 2, 2), (75, 75, 5, 5)]
    found = [tuple(s["parameters"][p]["true"] for p in ("k1", "k2", "B1", "B2")) for s in default["truth"]]
    assert found == [tuple(map(float, values)) for values in schedule]


def test_demo_alarms_are_exactly_those_that_the_schedule_calls_for(default: dict[str, Any]) -> None:
    delays = sorted(default["alarm_delays"], key=lambda found: (found["parameter"], found["changed_s"]))
    assert [(found["parameter"], found["changed_s"]) for found in delays] == CALLED_FOR
    assert len(default["alarms"]) == len(CALLED_FOR)
    # a window, and the on-delay of a window, must pass first
    assert all(0.25 <= found["delay_s"] < 1.0 for found in delays)


def test_demo_database_holds_what_the_document_says(default: dict[str, Any]) -> None:
    db = Path(default["db"])
    assert rows(db, "SELECT kind FROM v_runs") == [("demo",)]
    assert rows(db, "SELECT count(*) FROM v_estimates") == [(4 * ROWS,)]
    assert rows(db, "SELECT count(*) FROM v_alarms WHERE kind = 'level'") == [(len(CALLED_FOR),)]
    ledger = rows(
        db, "SELECT received, used, rejected, dropped, gaps FROM v_health ORDER BY t_ns DESC LIMIT 1"
    )
    assert ledger == [(3000, 3000, 0, 0, 0)]
    for name, estimate in default["estimates"].items():
        stored = rows(db, "SELECT value, sd, t_ns FROM v_latest WHERE parameter = ?", name)
        assert stored == [(estimate["value"], estimate["sd"], estimate["t_ns"])]


def test_demo_paper_scenario_finds_every_parameter_to_a_ten_thousandth(tmp_path: Path) -> None:
    """From the first window that holds only new samples on, every row: that ends W - 1 samples after the
    change."""
    document = demo("--scenario", "paper", "--fast", "--db", str(tmp_path / "paper.db"))
    assert_nothing_lost(document)
    found = rows(tmp_path / "paper.db", "SELECT t_ns, parameter, value FROM v_estimates ORDER BY t_ns")
    origin = found[0][0] - 49_000_000
    nominal = {"k1": 25.0, "k2": 100.0, "B1": 5.0, "B2": 5.0}
    assessed = 0
    for t_ns, name, value in found:
        sample = round((t_ns - origin) / 1e6)
        if sample % SECOND >= 249:
            true = document["truth"][sample // SECOND]["parameters"][name]["true"]
            assert abs(value - true) <= 1e-4 * nominal[name], (name, sample)
            assessed += 1
    assert assessed == 3 * 16 * 4


@pytest.mark.parametrize("seed", [7, 21])
def test_demo_random_schedule_passes(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    document = demo("--fast", seed=seed)
    # without --db the database is there to be asked, and nothing else is left
    assert [path for path in tmp_path.rglob("*.*") if not path.name.startswith("demo.db")] == []
    assert len(queries.estimates(Path(document["db"]))) == 4 * ROWS
    assert (document["scenario"], document["samples"]["received"]) == ("random", 3000)
    assert_nothing_lost(document)
    for where, cell in cells(document):
        assert abs(cell["estimate"] - cell["true"]) <= 3 * cell["sd"], where
        # after four windows the data do not exclude every unknown force yet
        assert cell["sd"] <= 1.4 * cell["bound_sd"], where
    assert len(document["alarms"]) == len(document["alarm_delays"])
    for found in document["alarm_delays"]:
        assert found["raised_s"] is not None
        assert found["raised_s"] < found["changed_s"] + 1.0


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [(["--scenario", "step"], 2, "--scenario"), (["--db", "no/such/folder/demo.db"], 3, "no/such/folder")],
)
def test_demo_that_cannot_be_played_exits_as_its_process_did_and_leaves_nothing(
    options: list[str], code: int, words: str, tmp_path: Path
) -> None:
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-m", "agent", "demo", "--json", *options], cwd=ROOT, env=environment,
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert done.returncode == code, done.stderr
    cause, *_, fault = json.loads(done.stdout)["errors"]
    assert words in f"{cause['path']} {cause['message']}"
    assert done.stderr.count(cause["message"]) == 1
    assert fault["message"].endswith(f"ended early (exit code {code})")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("seed", [1, 36, 54, 73])
def test_random_schedule_without_a_bus_raises_what_it_calls_for(seed: int, tmp_path: Path) -> None:
    played = play("random", tmp_path, seed)
    assert sorted((name, at // SECOND) for name, at in played.raised()) == sorted(called_for(played))


@pytest.mark.soak
def test_random_schedules_without_a_bus_pass_for_a_hundred_seeds(tmp_path: Path) -> None:
    """Twelve estimates a schedule, each within 3 sd: chance alone fails some 3 in 100 schedules.

    The intervals are near the bound in the median from the first second on; four windows do not exclude every
    unknown force in all schedules, twelve do so in nine of ten.
    """
    failed, shares = [], []
    for seed in range(100):
        played = play("random", tmp_path, seed)
        assert sorted((n, at // SECOND) for n, at in played.raised()) == sorted(called_for(played)), seed
        for last in (999, 1999, 2999):
            true, bound = played.truth(last), bounds(played, last)
            row = played.row(last).items()
            failed += [seed for n, (value, sd, _) in row if abs(value - true[n]) > 3 * sd]
            shares.append([sd / bound[n] for n, (_, sd, _) in row])
    assert len(set(failed)) <= 8, failed
    each = np.array(shares).reshape(100, 3, 4)
    assert (np.median(each, axis=(0, 2)) < 1.15).all()
    assert np.quantile(each[:, 2], 0.9) < 1.35


def test_agent_never_opens_what_the_device_plays(tmp_path: Path) -> None:
    """Schedule and truth are files of the device's; strace sees every file that the agent's process opens."""
    strace = peers.program("strace", "strace")
    config, trace, db = example("modbus", tmp_path), tmp_path / "trace", tmp_path / "rig.db"
    scenario = tmp_path / "wear.toml"
    default = ROOT / "sim_bus" / "scenarios" / "default.toml"
    scenario.write_text(default.read_text().replace("duration_s = 3.0", "duration_s = 1.5"), encoding="utf-8")
    simulator = Simulator(tmp_path, config.read_text(), "--scenario", str(scenario), "--fast")
    wrapper = [strace, "-f", "-qq", "-e", "trace=file", "-e", "signal=none", "-o", str(trace)]
    try:
        simulator.ready()
        with agent(simulator.config, options=["--db", str(db)], wrapper=wrapper) as running:
            wait_until(lambda: hops(db) == 30, "30 rows")
            # the signal goes to the agent, which is the tracer's child
            child = (
                Path(f"/proc/{running.process.pid}/task/{running.process.pid}/children").read_text().split()
            )
            os.kill(int(child[0]), signal.SIGTERM)
            assert running.end() == 0, running.err
    finally:
        simulator.stop()
    opened = set(re.findall(r'"([^"]*)"', trace.read_text(encoding="utf-8", errors="replace")))
    assert str(simulator.config) in opened, "the trace is blind"
    assert str(db) in opened
    assert simulator.truth_file.exists()
    strangers = [
        name for name in opened if name.startswith(str(tmp_path)) and Path(name).stem in {"wear", "truth"}
    ]
    assert not strangers
    assert not [name for name in opened if "sim_bus/scenarios" in name or name.endswith(default.name)]
