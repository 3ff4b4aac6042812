"""Every example of another domain: checked, run on a line of its own, replayed; alarms are those due."""

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.config import RigConfig, load
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import Scenario, load_scenario
from sim_bus.rig.trajectory import Rig
from tests.sim.rigs import ROOT

pytestmark = [pytest.mark.soak, pytest.mark.realtime]
OWN = {
    "voice_coil": "voice-coil", "loudspeaker": "voice-coil", "dc_drive": "dc-drive", "rlc_filter": "filter",
    "geared_drive": "gearbox", "gantry": "gantry", "oven": "oven", "transfer_line": "transfer",
}  # fmt: skip
SLOW = ("oven", "transfer_line")
"""Rigs that need hours: replayed only."""


def deltak(*arguments: str) -> dict[str, Any]:
    command = [sys.executable, "-m", "agent", *arguments, "--json"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def due(config: RigConfig, scenario: Scenario) -> set[str]:
    """Return the parameters that a scenario moves beyond their limits; limits are in per cent."""
    limits = {alarm.parameter: alarm.limit_percent or np.inf for alarm in config.limits}
    moved = {name: abs(percent) for change in scenario.change for name, percent in change.percent.items()}
    return {name for name, percent in moved.items() if percent > limits.get(name, np.inf)}


def raised(document: dict[str, Any]) -> set[str]:
    return {alarm["parameter"] for alarm in document["alarms"]}


@pytest.mark.parametrize("name", OWN)
def test_example_is_checked_and_replayed_with_the_alarms_due(name: str, tmp_path: Path) -> None:
    file = Path(shutil.copy(ROOT / f"deploy/examples/{name}.toml", tmp_path))
    assert deltak("check", str(file))["ok"]
    scenario, rig = load_scenario(OWN[name], {}), read_rig(file)
    rate = rig.rig.sample_rate_hz
    played = Rig(rig, scenario)
    chunk = played.advance(round(1.1 * (scenario.duration_s or 10.0) * rate))
    table = np.column_stack([np.arange(len(chunk)) / rate, chunk.readings])
    header = ",".join(["t", *(channel.name for channel in rig.channel)])
    recording = tmp_path / "played.csv"
    np.savetxt(recording, table, delimiter=",", header=header, comments="")
    document = deltak("replay", str(file), str(recording))
    assert raised(document) == due(load(file), scenario)
    truth = dict(zip(played.timeline.names, chunk.parameters[-1].tolist(), strict=True))
    for parameter, row in document["estimates"].items():
        assert abs(row["value"] - truth[parameter]) < 3.5 * row["sd"], (parameter, row, truth[parameter])


@pytest.mark.parametrize("name", [name for name in OWN if name not in SLOW])
def test_example_is_run_on_a_line_with_the_alarms_due(name: str, tmp_path: Path) -> None:
    file = Path(shutil.copy(ROOT / f"deploy/examples/{name}.toml", tmp_path))
    scenario = load_scenario(OWN[name], {})
    seconds = scenario.duration_s or 10.0
    command = [sys.executable, "-m", "agent", "sim", str(file), "--scenario", OWN[name], "--duration",
               str(seconds + 1.0)]  # fmt: skip
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as device:
        assert device.stdout is not None
        assert device.stdout.readline().strip() == "ready"
        document = deltak("run", str(file), "--duration", str(seconds + 1.0))
        device.terminate()
    ledger = document["sources"] if isinstance(document.get("sources"), list) else []
    assert all(source["received"] > 0 for source in ledger)
    raised_levels = {a["parameter"] for a in document["alarms"] if a.get("kind", "level") == "level"}
    assert raised_levels == due(load(file), scenario)
