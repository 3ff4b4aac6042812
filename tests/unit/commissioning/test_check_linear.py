"""`deltak check` of linear rigs: what hides, what a recording leaves open, the paper's conditions, the worst
point."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.commissioning.check import print_check
from agent.commissioning.check import check
from sim_bus.rig.rigfile import checked, read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig
from tests.peers import ROOT
from tests.scenario.test_linear_rigs import DISCRETE

COIL = (ROOT / "deploy/examples/voice_coil.toml").read_text(encoding="utf-8")


def checked_text(folder: Path, text: str, recording: Path | None = None) -> dict[str, Any]:
    file = folder / "rig.toml"
    file.write_text(text)
    return check(config=file, recording=recording, probe=False, progress=lambda _: None)


def recorded(folder: Path, text: str, force: dict[str, Any], seconds: float) -> Path:
    """Write what the simulator plays as a recording."""
    file = folder / "played.toml"
    file.write_text(text)
    noise = [{"channel": "position", "noise_sd": 1e-6}] if "position" in text else []
    scenario = checked(Scenario, {"force": [force], "sensor": noise}, "scenario")
    rig = read_rig(file)
    chunk = Rig(rig, scenario).advance(round(seconds * rig.rig.sample_rate_hz))
    t = np.arange(len(chunk)) / rig.rig.sample_rate_hz
    path = folder / "played.csv"
    header = ",".join(["t", *(channel.name for channel in rig.channel)])
    np.savetxt(path, np.column_stack([t, chunk.readings]), delimiter=",", header=header, comments="")
    return path


def words(document: dict[str, Any]) -> str:
    return json.dumps(document["errors"] + document["warnings"])


def test_entries_that_one_output_hides_are_named_with_the_output_that_helps(tmp_path: Path) -> None:
    text = DISCRETE.replace('uncertain = ["A[1,0]", "A[0,0]", "C[0,0]", "D[1,0]"]', 'uncertain = ["A", "B"]')
    text = text.replace("C = [[1.0, 0.0], [0.0, 1.0]]\nD = [[0.0], [0.02]]", "C = [[1.0, 0.0]]")
    start, end = text.index('[[channel]]\nname = "y2"'), text.index("[estimator]")
    text = text[:start] + text[end : text.index("[[alarm]]")]
    document = checked_text(tmp_path, text)
    assert not document["ok"]
    assert "A[0,1]" in words(document)
    assert "cannot be told apart" in words(document)
    assert "measure state 2" in words(document)


def test_recording_at_one_frequency_leaves_open_what_an_output_would_tell(tmp_path: Path) -> None:
    drive = {"kind": "sweep", "amplitude": 1.0, "from_hz": 3.0, "to_hz": 3.0, "over_s": 1.0}
    document = checked_text(tmp_path, COIL, recorded(tmp_path, COIL, drive, 1.5))
    assert document["ok"]
    assert "cannot be told apart" in words(document)
    assert "measure current as well" in words(document)


def test_paper_conditions_of_a_recording_are_in_the_document_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wide = {"kind": "random", "rms": 4.0}
    observer = 'observer = { gain = "poles", poles = [-2400, -2000, -1600] }'
    text = COIL.replace("[estimator]", f'[estimator]\nmethod = "seed"\n{observer}')
    document = checked_text(tmp_path, text, recorded(tmp_path, COIL, wide, 1.5))
    found = document["paper_conditions"]
    assert found["condition_12"] == {"rank": 3, "rank_joined": found["condition_12"]["rank_joined"]}
    assert found["condition_15"]["z_zero"]
    assert 0 < found["condition_11"]["defect_states"] < 1
    assert document["recentring"] == {**document["recentring"], "converges": False}
    assert "re-centred passes do not reach" in words(document)
    print_check(document)
    said = capsys.readouterr().out
    assert "Z = 0 would do here" in said
    assert "at worst" in said


def test_conditions_of_more_than_eight_parameters_do_not_vanish(tmp_path: Path) -> None:
    entries = [f"A[{i},{j}]" for i in range(3) for j in range(3)]
    A = [[0.9, 0.05, 0.0], [-0.05, 0.85, 0.1], [0.0, -0.1, 0.8]]
    text = (
        '[rig]\nname = "nine"\nsample_rate_hz = 100.0\n'
        '[model]\nkind = "linear"\ntime = "discrete"\nrate_hz = 100.0\n'
    )
    text += (
        f"A = {A}\nB = [[1.0], [0.0], [0.0]]\nC = {np.eye(3).tolist()}\nuncertain = {json.dumps(entries)}\n"
    )
    text += '[[channel]]\nname = "u"\nquantity = "input"\nunit = "V"\n'
    text += "".join(
        f'[[channel]]\nname = "y{i}"\nquantity = "output"\nunit = "V"\nnoise_sd = 1e-3\n' for i in range(3)
    )
    text += "[estimator]\nwindow_s = 4.0\n"
    text += "".join(f'[[alarm]]\nparameter = "{name}"\nlimit = 0.04\n' for name in entries)
    document = checked_text(tmp_path, text)
    assert document["ok"], words(document)
    assert document["condition_8"]["perturbation_norm"] > 0.04
    assert set(document["region"]["radius_model"]["at"]) == set(entries)
    assert document["region"]["radius_model"]["value"] > document["region"]["radius_model"]["nominal"]
    assert "9 parameters have a limit, at most 8 can be tried" in words(document)
