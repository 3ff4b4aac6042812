"""The scenarios that ship, from end to end on simulated time, and the command that scores them."""

import json
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.cli.app import app
from agent.errors import UsageError
from agent.evaluation.score.play import shipped
from agent.evaluation.score.score import score
from sim_bus.rig.scenario import scenario_path

SHIPPED = (
    "bus-off", "busy-plc", "hammer", "healthy", "noisy-line", "ramp", "rebooted", "slow-clock", "standstill",
    "step",
    "stuck-sensor", "sweep", "unplugged", "wandering", "warm-day",
)  # fmt: skip


def quiet(_name: str, _share: float) -> None:
    """Show no progress."""


def changed(name: str, folder: Path, **replaced: str) -> Path:
    """Write a shipped scenario anew with lines replaced, its rig where it was; short."""
    source = scenario_path(name)
    text = source.read_text(encoding="utf-8").replace('rig = "rigs', f'rig = "{source.parent}/rigs')
    for old, new in replaced.items():
        lines = [new if line.startswith(f"{old} =") else line for line in text.splitlines()]
        text = "\n".join(lines) + "\n"
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_shipped_scenarios_are_those_with_a_case() -> None:
    assert tuple(shipped()) == SHIPPED


def test_score_whose_expectation_is_not_met_says_so_and_exits_with_1(tmp_path: Path) -> None:
    path = changed("step", tmp_path, duration_s="duration_s = 3.0", delay_s="delay_s = 0.1", lost="gaps = 7")
    result = CliRunner().invoke(app, ["score", str(path), "--json"])
    assert result.exit_code == 1
    document = json.loads(result.stdout)
    failures = document["scenarios"][0]["failures"]
    assert [words.split(":")[0] for words in failures] == ["delay_s", "gaps"]
    assert document["ok"] is False


def test_score_as_a_table_names_what_was_found_and_what_was_not_met(tmp_path: Path) -> None:
    path = changed("unplugged", tmp_path, gaps="gaps = 2", duration_s="duration_s = 4.0")
    result = CliRunner().invoke(app, ["score", str(path), "--fault", "serial.duplicate@0.5"])
    assert result.exit_code == 1
    assert "NOT MET" in result.stdout
    assert "gaps: 1 is not 2" in result.stdout
    assert "events: ('duplicate', 'lost') is not ('lost',)" in result.stdout
    assert "0 of 1 scenarios as expected" in result.stdout


def test_score_two_runs_are_alike(tmp_path: Path) -> None:
    path = str(changed("noisy-line", tmp_path, duration_s="duration_s = 3.0"))
    assert score([path], [], quiet) == score([path], [], quiet)


@pytest.mark.parametrize(
    ("replaced", "words"),
    [
        ({"rig": ""}, "rig: names no configuration"),
        ({"missed": "mist = 0"}, "expect.mist"),
        ({"duration_s": ""}, "duration_s: without an end"),
    ],
)
def test_score_scenario_that_cannot_be_scored_is_refused(
    replaced: dict[str, str], words: str, tmp_path: Path
) -> None:
    path = changed("step", tmp_path, **replaced)
    with pytest.raises(UsageError, match=words):
        score([str(path)], [], quiet)


def test_score_of_devices_of_different_rates_is_refused(tmp_path: Path) -> None:
    rig = scenario_path("step").parent / "rigs"
    for file in rig.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    scenario = changed("step", tmp_path, rig='rig = "own.toml"')
    named = tomllib.loads(scenario_path("step").read_text(encoding="utf-8"))["rig"].removeprefix("rigs/")
    text = (rig / named).read_text(encoding="utf-8").replace("[[source]]", "[[source]]\nrate_hz = 500.0", 1)
    (tmp_path / "own.toml").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="rate_hz: only devices of the rig's rate can be scored"):
        score([str(scenario)], [], quiet)
