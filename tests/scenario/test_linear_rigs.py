"""Linear rigs are played and watched as springs are: a hidden domain on a real bus, wear of entries, discrete
time."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock
from sim_bus.rig.rigfile import checked, read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig
from tests.sim.rigs import ROOT

DISCRETE = """
[rig]
name = "loop"
sample_rate_hz = 100.0
[model]
kind = "linear"
time = "discrete"
rate_hz = 100.0
A = [[0.95, 0.08], [-0.08, 0.95]]
B = [[0.0], [0.1]]
C = [[1.0, 0.0], [0.0, 1.0]]
D = [[0.0], [0.02]]
uncertain = ["A[1,0]", "A[0,0]", "C[0,0]", "D[1,0]"]
[[channel]]
name = "drive"
quantity = "input"
unit = "V"
gain_sd_percent = 0.0
[[channel]]
name = "y1"
quantity = "output"
unit = "m"
noise_sd = 1e-4
gain_sd_percent = 0.0
[[channel]]
name = "y2"
quantity = "output"
unit = "m"
noise_sd = 1e-4
gain_sd_percent = 0.0
[estimator]
window_s = 2.0
hop_s = 0.5
[[alarm]]
parameter = "A[1,0]"
limit_percent = 20.0
[[alarm]]
parameter = "C[0,0]"
limit = 0.03
[[alarm]]
parameter = "D[1,0]"
limit = 0.01
[[source]]
driver = "serial"
port = "loop.tty"
baudrate = 115200
format = "binary"
sync = "AA55"
fields = [{ name = "drive", type = "float64" }, { name = "y1", type = "float64" }, \
{ name = "y2", type = "float64" }]
map = { drive = "drive", y1 = "y1", y2 = "y2" }
"""
SCENARIO = {
    "seed": 3,
    "force": [{"kind": "random", "rms": 1.0}],
    "noise": {"output": 1e-4},
    "change": [{"at_s": 10.0, "percent": {"C[0,0]": 5.0}}],
    "wear": [{"kind": "temperature", "rate": {"A[1,0]": 1e-4}, "amplitude": 10.0, "period_s": 80.0}],
}


def play(
    file: Path, scenario: dict[str, object], seconds: float
) -> tuple[list[Record], dict[str, FloatArray]]:
    """Play a scenario on simulated time into the pipeline; return its records and the truth of each
    parameter."""
    config = load(file)
    rig = Rig(read_rig(file), checked(Scenario, scenario, "scenario"))
    rate = config.rig.sample_rate_hz
    chunk = rig.advance(round(seconds * rate))
    names = [c.name for c in config.channel]
    pipeline = Pipeline(config, dict.fromkeys(names, 0.0), {"wire": {name: name for name in names}})
    t_ns = np.arange(0, len(chunk), 100) * round(1e9 / rate)
    records: list[Record] = []
    for start, at in zip(range(0, len(chunk), 100), t_ns.tolist(), strict=True):
        values = chunk.readings[start : start + 100]
        block = SampleBlock(values, at, np.arange(start, start + len(values), dtype=np.int64))
        records += pipeline.step("wire", block, 2**32, None)
    return records, dict(zip(rig.timeline.names, chunk.parameters.T, strict=True))


def test_entries_of_a_rig_in_discrete_time_are_followed_and_alarmed(tmp_path: Path) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE)
    records, truth = play(file, SCENARIO, 20.0)
    last = [r for r in records if isinstance(r, EstimateBatch)][-1]
    for name, value, sd, status in zip(
        last.parameters, last.value[-1], last.sd[-1], last.status[-1], strict=True
    ):
        middle = truth[name][last.index[-1] - 100]  # wear goes on within the window
        assert abs(value - middle) < 4 * sd, name
        assert Status(int(status)) is Status.VALID
    raised = [r.parameter for r in records if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    assert raised == ["C[0,0]"]


def test_stuck_sensor_of_a_linear_rig_is_found_as_one_of_springs_is(tmp_path: Path) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE)
    stuck = {
        **SCENARIO,
        "change": [],
        "wear": [],
        "sensor": [{"channel": "y1", "stuck": True, "from_s": 8.0}],
    }
    records, _ = play(file, stuck, 14.0)
    last = [r for r in records if isinstance(r, EstimateBatch)][-1]
    assert not np.any(last.status[-1] == int(Status.VALID))
    raised = [r for r in records if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    assert {r.kind for r in raised} == {"sensor"}


@pytest.mark.realtime
def test_demo_of_a_voice_coil_tells_what_lies_between_voltage_and_position() -> None:
    command = [sys.executable, "-m", "agent", "demo", "--json", "--rig", "voice-coil", "--bus", "serial"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    cells = [cell for segment in document["truth"] for cell in segment["parameters"].items()]
    assert [name for name, _ in cells] == 3 * ["R", "k", "b", "K"]
    assert all(cell["status"] == "valid" and abs(cell["error_sd"]) < 4 for _, cell in cells), cells
    assert sum(abs(cell["error_sd"]) < 3 for _, cell in cells) >= 11
    assert [alarm["parameter"] for alarm in document["alarms"]] == ["R", "k"]
    assert all(0 < delay["delay_s"] < 0.8 for delay in document["alarm_delays"])
