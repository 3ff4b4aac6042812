"""`deltak identify` on the command line: values, refusals, the file it writes, and what bad input says."""

import csv
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.commissioning.nominals import edited
from agent.errors import UsageError
from tests.statistical.unknown_machines import Machine, configuration, machine, recorded

RIG = np.random.default_rng(3)
ONE = machine(RIG, 2)
COLUMNS = recorded(ONE, RIG, 1e-3, span_s=20.0)
TEXT = configuration(ONE, COLUMNS, ONE.masses)


def files(folder: Path, columns: dict[str, Any] = COLUMNS, text: str = TEXT) -> list[str]:
    config, recording = folder / "rig.toml", folder / "run.csv"
    config.write_text(text, encoding="utf-8")
    with recording.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(columns)
        table.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
    return [str(config), str(recording)]


def run(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = guarded(app, arguments)
    return code, *capfd.readouterr()


@pytest.mark.parametrize("command", ["run", "replay"])
def test_what_needs_nominals_refuses_and_advises_to_identify(
    command: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, recording = files(tmp_path)
    code, _, err = run([command, config, *([recording] if command == "replay" else [])], capfd)
    assert code == 2
    assert "model.spring[0].nominal: is missing; " in err
    assert "deltak identify" in err
    assert len(err.splitlines()) == 4


def test_check_accepts_a_file_that_is_yet_to_be_identified_and_says_so(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, recording = files(tmp_path)
    code, out, _ = run(["check", config], capfd)
    assert code == 0
    assert "usable once it is identified" in out
    assert "warning: model.spring[0].nominal: is missing; " in out
    assert run(["check", config, "--recording", recording], capfd)[0] == 2
    Path(config).write_text(TEXT.replace("mass", "mess", 1), encoding="utf-8")
    assert run(["check", config], capfd)[0] == 2


def test_identify_writes_nominals_that_replay_then_runs_with(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, recording = files(tmp_path, text=f"# of the shop floor\n{TEXT}")
    plot = tmp_path / "seen.png"
    code, out, err = run(["identify", config, recording, "--write", "--plot", str(plot)], capfd)
    assert code == 0, err
    assert "share of the motion left unexplained" in out
    assert "k1: nothing -> " in out
    assert plot.stat().st_size > 5000
    text = Path(config).read_text(encoding="utf-8")
    assert text.startswith("# of the shop floor\n")
    code, out, err = run(["replay", config, recording, "--json"], capfd)
    assert code == 0, err
    for name, true in ONE.truth.items():
        assert json.loads(out)["estimates"][name]["value"] == pytest.approx(true, rel=0.03)


def test_identify_says_json_and_nothing_else_and_changes_nothing(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, recording = files(tmp_path)
    code, out, _ = run(["identify", config, recording, recording, "--json"], capfd)
    document = json.loads(out)
    assert code == 0
    assert document["span_s"] == pytest.approx(40.0, rel=0.01)
    assert document["unexplained_percent"] < 0.1
    assert set(document["parameters"]) == set(ONE.truth)
    for name, row in document["parameters"].items():
        assert row["identifiable"]
        assert row["lower"] < ONE.truth[name] < row["upper"]
    assert Path(config).read_text(encoding="utf-8") == TEXT


def still() -> dict[str, Any]:
    noise = np.random.default_rng(0)
    return {key: v if key[0] in "tf" else 1e-6 * noise.normal(size=len(v)) for key, v in COLUMNS.items()}


def _without_channel(text: str, name: str) -> str:
    head, *channels = text.split("[[channel]]")
    return "[[channel]]".join([head, *(c for c in channels if f'"{name}"' not in c)])


def chain(quantity: str) -> tuple[Machine, dict[str, Any], str]:
    """Return two masses in a row of which one motion is measured, with recording and configuration."""
    rng = np.random.default_rng(7)
    one = machine(rng, 2)
    sensors = ((quantity, 1),)
    columns = recorded(one, rng, 1e-3, span_s=20.0, sensors=sensors)
    return one, columns, configuration(one, columns, one.masses, sensors=sensors)


BAD = {
    "without motion": (still(), TEXT, "nothing moves beyond the noise of its sensor"),
    "two alike": (COLUMNS | {"x1": COLUMNS["x2"]}, TEXT, "read the same to the last digit"),
    "too short": ({k: v[:100] for k, v in COLUMNS.items()}, TEXT, "no 128 samples without a gap"),
    "no force, a motion missing": (chain("displacement")[1], _without_channel(chain("displacement")[2], "f2"),
                                   "no displacement or velocity of m2 is measured, and no force"),
}  # fmt: skip


@pytest.mark.parametrize("kind", list(BAD))
def test_bad_input_is_said_in_a_sentence_and_changes_nothing(
    kind: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    columns, text, words = BAD[kind]
    config, recording = files(tmp_path, columns, text)
    code, _, err = run(["identify", config, recording, "--write"], capfd)
    assert code == 2
    assert words in err
    assert Path(config).read_text(encoding="utf-8") == text


def test_machine_with_a_single_accelerometer_is_identified(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    one, columns, text = chain("acceleration")
    config, recording = files(tmp_path, columns, text)
    code, out, err = run(["identify", config, recording, "--json"], capfd)
    assert code == 0, err
    for name, row in json.loads(out)["parameters"].items():
        assert row["lower"] < one.truth[name] < row["upper"]
        assert row["sd"] < (0.03 if name[0] == "k" else 0.2) * row["value"], name


def test_spring_that_drowns_is_named_and_so_is_the_sensor_that_would_show_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng, sensors = np.random.default_rng(9), (("displacement", 1),)
    ends = ((0, 1), (1, 2))
    # a mass of a thousandth rides on the one that is pushed and measured
    one = Machine(np.array([10.0, 0.01]), ends, np.array([1e3, 25.0]), np.array([10.0, 0.05]), (1,))
    columns = recorded(one, rng, 0.03, span_s=10.0, sensors=sensors)
    text = configuration(one, columns, one.masses, sensors=sensors)
    config, recording = files(tmp_path, columns, text)
    code, out, err = run(["identify", config, recording, "--json"], capfd)
    assert code == 0, err
    document = json.loads(out)
    # a line of the noise passes for its resonance, as sharp as can be
    assert document["parameters"]["k2"]["sd"] < 0.1 * document["parameters"]["k2"]["value"]
    for name in ("k2", "B2"):
        assert "measure the displacement of m2" in document["parameters"][name]["why"]
    assert {change["parameter"] for change in document["changes"]} == {"k1", "B1"}


def test_branches_that_may_change_places_have_both_solutions_and_the_sensor_that_tells(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng, sensors = np.random.default_rng(4), (("displacement", 1),)
    # two equal masses hang on the one that is pushed and measured: nothing says which spring holds which
    k, B = np.array([900.0, 200.0, 500.0]), np.array([4.0, 1.0, 2.5])
    one = Machine(np.array([4.0, 1.0, 1.0]), ((0, 1), (1, 2), (1, 3)), k, B, (1,))
    columns = recorded(one, rng, 1e-3, span_s=20.0, sensors=sensors)
    config, recording = files(tmp_path, columns, configuration(one, columns, one.masses, sensors=sensors))
    code, out, err = run(["identify", config, recording, "--json"], capfd)
    assert code == 0, err
    document = json.loads(out)
    for name, other in (("k2", "k3"), ("k3", "k2"), ("B2", "B3"), ("B3", "B2")):
        row = document["parameters"][name]
        assert not row["identifiable"]
        assert "explain the recordings alike" in row["why"]
        assert "measure the displacement of m" in row["why"]
        both = sorted([row["value"], row["other"]])
        assert both == pytest.approx(sorted([one.truth[name], one.truth[other]]), rel=0.05)
    assert document["parameters"]["k1"]["identifiable"]
    assert {change["parameter"] for change in document["changes"]} == {"k1", "B1"}


def test_spring_that_nothing_stretches_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rest = np.random.default_rng(1).normal(size=len(COLUMNS["t"]))
    text = TEXT.replace("mass = [", 'mass = [{ name = "m3", value = 1.0 }, ').replace(
        "spring = [", 'spring = [{ name = "k9", between = ["ground", "m3"] }, '
    ) + '\n[[channel]]\nname = "x3"\nquantity = "displacement"\nat = "m3"\nunit = "m"\n'  # fmt: skip
    config, recording = files(tmp_path, COLUMNS | {"x3": 1e-6 * rest}, text)
    code, _, err = run(["identify", config, recording], capfd)
    assert code == 2
    assert "k9 cannot be known: m3 rests in all of the recordings; record a motion that stretches them" in err


def test_file_that_cannot_be_written_is_left_as_it_was(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    config, recording = files(tmp_path)

    def full(_handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    code, _, err = run(["identify", config, recording, "--write"], capfd)
    assert code == 2
    assert "cannot be written: No space left on device; nothing was changed" in err
    assert Path(config).read_text(encoding="utf-8") == TEXT
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.toml", "run.csv"]


TABLES = """
[model]  # the press
mass = [{ name = "m1", value = 5 }]
[[model.spring]]
name = "k1"  # front
between = ["ground", "m1"]
nominal = 1_0.5   # guessed

[[model.damper]]
name = 'B1'
between = ["ground", "m1"]
[[channel]]
name = "x1"
"""


def test_values_go_where_the_names_stand_and_nothing_else_changes() -> None:
    found = edited(TABLES, {"k1": 25.0, "B1": 5.25}, Path("rig.toml"))
    assert found == TABLES.replace("1_0.5", "25.0").replace("name = 'B1'\n", "name = 'B1'\nnominal = 5.25\n")


def test_text_without_a_place_for_a_value_is_left_alone() -> None:
    text = (
        '[model]\nmass = [{ value = 5, "name" = "m1" }]\n'
        'spring = [{ "name" = "k1", between = ["ground", "m1"] }]\n'
    )
    with pytest.raises(UsageError, match="enter 25 there yourself"):
        edited(text, {"k1": 25.0}, Path("rig.toml"))


def test_identify_graph_finds_the_element_that_the_file_lacks_and_writes_nothing_into_another_graph(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    lacking = TEXT.replace(f', {{ name = "B2", between = {_between(TEXT, "B2")} }}', "")
    assert lacking != TEXT
    config, recording = files(tmp_path, text=lacking)
    code, _, err = run(["identify", config, recording, "--graph", "--write", "--json"], capfd)
    assert code == 2
    assert "the graph chosen is not the file's; nothing was written" in err
    assert '{ name = "B_' in err
    assert Path(config).read_text(encoding="utf-8") == lacking


def _between(text: str, name: str) -> str:
    return text.partition(f'name = "{name}", between = ')[2].partition("]")[0] + "]"


def test_identify_graph_that_is_right_is_kept_and_written(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    config, recording = files(tmp_path)
    code, out, err = run(["identify", config, recording, "--graph", "--write"], capfd)
    assert code == 0, err
    (chosen,) = [line for line in out.splitlines() if "chosen" in line]
    assert chosen.split() == ["k1,", "k2,", "B1,", "B2", "0", "chosen,", "the", "file's"]
    assert "written to" in out
    assert "nominal = " in Path(config).read_text(encoding="utf-8")
