"""`deltak identify` of linear models and templates: from far off, written where the numbers stand, refused in
words."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.commissioning.nominals import with_nominals, with_numbers
from agent.config import load
from agent.errors import UsageError
from sim_bus.rig.rigfile import checked, read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig
from tests.peers import ROOT
from tests.scenario.test_linear_rigs import DISCRETE

EXAMPLES = ROOT / "deploy/examples"


def played(file: Path, scenario: dict[str, Any], seconds: float) -> tuple[Path, dict[str, float]]:
    """Write what the simulator plays beside a configuration; return the recording and the truth."""
    rig = read_rig(file)
    run = Rig(rig, checked(Scenario, {"seed": 4, **scenario}, "scenario"))
    chunk = run.advance(round(seconds * rig.rig.sample_rate_hz))
    t = np.arange(len(chunk)) / rig.rig.sample_rate_hz
    recording = file.with_suffix(".csv")
    header = ",".join(["t", *(channel.name for channel in rig.channel)])
    np.savetxt(recording, np.column_stack([t, chunk.readings]), delimiter=",", header=header, comments="")
    return recording, dict(zip(run.timeline.names, chunk.parameters[-1].tolist(), strict=True))


RIGS: dict[str, tuple[str, dict[str, Any], float]] = {
    "oven": (
        (EXAMPLES / "oven.toml").read_text(encoding="utf-8"),
        {"force": [{"kind": "random", "rms": 800.0, "at": "heater"},
                   {"kind": "random", "rms": 1.0, "at": "room"}],
         "noise": {"temperature": 0.02}, "change": [{"at_s": 0.0, "percent": {"R1": 50.0, "R2": -40.0}}]},
        1.5e4,
    ),
    "geared_drive": (
        (EXAMPLES / "geared_drive.toml").read_text(encoding="utf-8"),
        {"force": [{"kind": "random", "rms": 1.0}], "noise": {"speed": 1e-3},
         "change": [{"at_s": 0.0, "percent": {"k": -30.0, "b1": 60.0, "b2": 50.0}}]},
        6.0,
    ),
    "discrete": (
        DISCRETE,
        {"force": [{"kind": "random", "rms": 1.0}], "noise": {"output": 1e-4},
         "change": [{"at_s": 0.0, "percent": {"A[1,0]": 30.0, "C[0,0]": 5.0, "D[1,0]": 40.0}}]},
        30.0,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", RIGS)
def test_parameters_far_from_their_nominals_are_found_and_written(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    text, scenario, seconds = RIGS[name]
    file = tmp_path / "rig.toml"
    file.write_text(text, encoding="utf-8")
    recording, truth = played(file, scenario, seconds)
    code = guarded(app, ["identify", str(file), str(recording), "--write", "--json"])
    out, err = capfd.readouterr()
    assert code == 0, err
    found = json.loads(out)["parameters"]
    for key, row in found.items():
        assert abs(row["value"] - truth[key]) < 4 * row["sd"] < 0.05 * abs(truth[key]), (key, row)
    now = load(file).parameters
    assert {key: now[key].nominal for key in found} == pytest.approx(
        {key: row["value"] for key, row in found.items()}, rel=1e-5
    )
    assert len(file.read_text(encoding="utf-8").splitlines()) == len(text.splitlines())
    assert guarded(app, ["identify", str(file), str(recording), "--graph"]) == 2
    assert "has no graph to choose" in capfd.readouterr().err


def test_motion_of_another_plant_is_refused_and_nothing_is_written(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(DISCRETE)
    recording, _ = played(file, RIGS["discrete"][1], 5.0)
    t, drive, y1, y2 = np.loadtxt(recording, delimiter=",", skiprows=1).T
    np.savetxt(recording, np.column_stack([t, drive, y1, y2[::-1]]), delimiter=",", header="t,drive,y1,y2",
               comments="")  # fmt: skip
    assert guarded(app, ["identify", str(file), str(recording), "--write"]) == 2
    assert "the motion of y2 unexplained; begin at nominals nearer" in capfd.readouterr().err
    assert file.read_text() == DISCRETE


def test_values_of_templates_and_matrices_go_where_they_stand() -> None:
    values = {
        "rlc_filter": {"R1": 7.5, "C2": 2.5e-5, "load": 70.0},
        "transfer_line": {"pipe.R": 2.5e6, "valve": 3.5e6},
        "gantry": {"tau": 1.5e-4, "arm": 260.5, "post.mass": 2.5},
        "voice_coil": {"R": 4.5, "K": 5.25},
        "dc_drive": {"R": 1.5, "K": 0.0625},
    }
    for name, wanted in values.items():
        config = load(EXAMPLES / f"{name}.toml")
        moved = with_nominals(config, wanted)
        assert {key: moved.parameters[key].nominal for key in wanted} == wanted
    coil = with_nominals(load(EXAMPLES / "voice_coil.toml"), values["voice_coil"]).model
    assert coil.A[0] == (-1125.0, -1312.5, 0.0)  # type: ignore[union-attr]


def test_matrix_that_stands_in_a_file_is_not_written(tmp_path: Path) -> None:
    text = '[model]\nA = { file = "a.csv" }\n'
    with pytest.raises(
        UsageError, match=r'value of "model\.A\[0\]\[1\]" is found.*enter 0\.5 there yourself'
    ):
        with_numbers(text, {("A", 0, 1): 0.5}, tmp_path / "rig.toml")
