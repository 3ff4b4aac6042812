"""Limits from a learnt spread: proposed, written into a file that stays otherwise as it is, and tried on the
past."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.commissioning.baseline import tried
from agent.commissioning.baseline.limits import limit_warnings
from agent.commissioning.baseline.written import with_limits
from agent.commissioning.check import check
from agent.config import load
from agent.errors import UsageError
from agent.storage.write.store import Store
from tests.peers import ROOT
from tests.storage.rows import run_info, step
from tests.unit.commissioning.test_baseline import rows as rows_of

EXAMPLE = ROOT / "deploy/examples/modbus.toml"
GRAPH = "spring k1 ground-m1; spring k2 m1-m2; damper B1 ground-m1; damper B2 m1-m2"
RIG = "two-mass-rig"


def deltak(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = guarded(app, [str(word) for word in argv])
    return (code, *capsys.readouterr())


def asked(capsys: pytest.CaptureFixture[str], *argv: object) -> dict[str, Any]:
    code, out, err = deltak(capsys, *argv, "--json")
    assert code == 0, err
    document: dict[str, Any] = json.loads(out)
    return document


def machine(folder: Path, loss: float = 0.0, **changes: str) -> Path:
    """A configuration whose store has three days of rows, k1 weaker by `loss` for some hours of the third."""
    made = rows_of(3 * 1440)
    value = made.value.copy()
    value[3000:3300, 0] -= loss
    full = replace(made, rig=RIG, value=value, lower=value - 2 * made.sd, upper=value + 2 * made.sd)
    config = folder / "rig.toml"
    text = EXAMPLE.read_text(encoding="utf-8")
    for old, new in changes.items():
        text = text.replace(old, new)
    config.write_text(text, encoding="utf-8")
    with Store.open(load(config).store.path) as store:
        run = store.begin_run(replace(run_info(rig=RIG), graph=GRAPH))
        store.write(run, [full])
    return config


@pytest.fixture
def config(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    made = machine(tmp_path)
    assert deltak(capsys, "baseline", "learn", made)[0] == 0
    return made


def test_limits_without_a_baseline_say_how_to_learn_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made = machine(tmp_path)
    before = made.read_bytes()
    code, out, err = deltak(capsys, "limits", made, "--write")
    assert (code, out) == (2, "")
    assert "has no baseline, and so no spread to set limits by" in err
    assert f"deltak baseline learn {made}" in err
    assert made.read_bytes() == before


def test_limits_follow_the_spread_and_say_what_they_find(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = asked(capsys, "limits", config)["parameters"]
    assert set(found) == {"k1", "k2"}
    assert found["k2"]["limit"] == pytest.approx(4 * found["k1"]["limit"], rel=0.6)
    for row in found.values():
        assert row["false_per_year"] <= 1.0
        assert row["finds"] > row["limit"] > 3 * row["spread_sd"]
        assert row["finds_within_s"] > row["on_delay_s"] > 0
    fewer = asked(capsys, "limits", config, "--per-year", "0.01")["parameters"]
    assert fewer["k1"]["limit"] > found["k1"]["limit"]
    assert deltak(capsys, "limits", config, "--per-year", "0")[0] == 2
    code, out, _ = deltak(capsys, "limits", config)
    assert code == 0
    assert "finds a change of" in out


def test_write_changes_limits_and_delays_and_nothing_else(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = config.read_text(encoding="utf-8").splitlines()
    found = asked(capsys, "limits", config, "--write")
    assert found["written"] == str(config)
    after = config.read_text(encoding="utf-8").splitlines()
    gone = [line for line in before if line not in after]
    new = [line for line in after if line not in before]
    assert [re.sub(r"[\d.]+", "", line, count=1) for line in gone] == [
        re.sub(r"[\d.]+", "", line, count=1) for line in new if line.startswith("limit")
    ]
    assert sum(line.startswith("on_delay_s = ") for line in new) == len(new) - len(gone) == 2
    alarms = {alarm.parameter: alarm for alarm in load(config).alarm}
    for name, row in found["parameters"].items():
        assert (alarms[name].limit, alarms[name].on_delay_s) == (row["limit"], row["on_delay_s"])
    assert alarms["B1"].limit == 2.0


def test_write_beside_a_database_needs_the_configuration(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    db = load(config).store.path
    code, _, err = deltak(capsys, "limits", db, "--write")
    assert code == 2
    assert "no configuration to write to" in err
    moved = config.with_name("moved.toml")
    moved.write_text(config.read_text(encoding="utf-8").replace('path = "', 'path = "not-'), encoding="utf-8")
    assert asked(capsys, "limits", db, "--write", "--config", moved)["written"] == str(moved)
    assert load(moved).alarm[0].limit == asked(capsys, "limits", db)["parameters"]["k1"]["limit"]


PLAIN = '[rig]\nname = "a"\n'


@pytest.mark.parametrize(
    ("alarm", "written"),
    [
        (
            '[[alarm]]   # of the spring\nparameter = "k1"\nlimit_percent = 10   # as ever\nside = "low"\n',
            (
                '[[alarm]]   # of the spring\nparameter = "k1"\non_delay_s = 2.0\n'
                'limit = 1.5   # as ever\nside = "low"\n'
            ),
        ),
        (
            'alarm = [{ parameter = "k2", limit = 3 }, { parameter = "k1", limit = 15.0 }]  # both\n',
            (
                'alarm = [{ parameter = "k2", limit = 3 }, '
                '{ parameter = "k1", on_delay_s = 2.0, limit = 1.5 }]  # both\n'
            ),
        ),
        (
            '[[alarm]]\nlimit = 15\non_delay_s = 9\nparameter = "k1"\n',
            '[[alarm]]\nlimit = 1.5\non_delay_s = 2.0\nparameter = "k1"\n',
        ),
        ("", '\n[[alarm]]\nparameter = "k1"\nlimit = 1.5\non_delay_s = 2.0\n'),
    ],
)
def test_limits_take_the_place_of_those_there_in_every_form(alarm: str, written: str, tmp_path: Path) -> None:
    before, after = ("", "") if alarm.startswith("alarm") else (PLAIN, "")
    text = before + alarm + after
    assert (
        with_limits(text, {"k1": {"limit": 1.5, "on_delay_s": 2.0}}, tmp_path / "a.toml") == before + written
    )


def test_limits_that_would_make_the_file_faulty_are_not_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = machine(tmp_path, **{"limit = 15.0 ": "deadband = 14.0\nlimit = 15.0 "})
    assert deltak(capsys, "baseline", "learn", config)[0] == 0
    before = config.read_bytes()
    code, _, err = deltak(capsys, "limits", config, "--write")
    assert code == 2
    assert "deadband" in err
    assert "nothing was changed" in err
    assert config.read_bytes() == before


def test_check_warns_of_a_limit_under_what_the_spread_allows(
    config: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list(limit_warnings(load(config))) == []
    config.write_text(
        config.read_text(encoding="utf-8").replace("limit = 15.0", "limit = 0.2"), encoding="utf-8"
    )
    found = check(config=config, recording=None, probe=False)["warnings"]
    assert [row["path"] for row in found if "healthy machine" in row["message"]] == ["alarm[0].limit"]
    asked(capsys, "limits", config, "--write")
    assert list(limit_warnings(load(config))) == []


@pytest.mark.parametrize("at_a_time", [5000, 7])
def test_try_says_which_alarms_other_limits_would_have_raised(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, at_a_time: int
) -> None:
    monkeypatch.setattr(tried, "ROWS_TRIED", at_a_time)
    config = machine(tmp_path, loss=5.0)
    other = tmp_path / "other.toml"
    text = config.read_text(encoding="utf-8")
    other.write_text(text.replace("limit = 15.0", "limit = 3.0"), encoding="utf-8")
    found = asked(capsys, "limits", config, "--try", other)
    assert (found["were"], found["fewer"]) == ([], [])
    (one,) = found["more"]
    assert one["parameter"] == "k1"
    assert one["raised_at"].startswith("2026-01-03T02:0")
    assert one["cleared_at"].startswith("2026-01-03T07:0")
    assert one["delta"] == pytest.approx(-5.0, abs=0.5)
    code, out, _ = deltak(capsys, "limits", config, "--try", other)
    assert code == 0
    assert "1 alarm in place of 0" in out
    assert asked(capsys, "limits", config, "--try", config)["more"] == []


def test_try_counts_an_alarm_that_was_raised_once_and_says_which_would_be_gone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = machine(tmp_path, loss=5.0)
    begun = 1_767_225_600_000_000_000 + 3002 * 60_000_000_000
    with Store.open(load(config).store.path) as store:
        run = store.begin_run(replace(run_info(rig=RIG), graph=GRAPH, started_ns=begun))
        raised = step("NORM", "UNACK", begun, rig=RIG, cause="raise", limit_value=3.0)
        store.write(run, [raised, step("UNACK", "RTNUN", begun + 10**12, rig=RIG, cause="clear")])
    same = tmp_path / "same.toml"
    same.write_text(
        config.read_text(encoding="utf-8").replace("limit = 15.0", "limit = 3.0"), encoding="utf-8"
    )
    found = asked(capsys, "limits", config, "--try", same)
    assert (len(found["would"]), found["more"], found["fewer"]) == (1, [], [])
    (gone,) = asked(capsys, "limits", config, "--try", config)["fewer"]
    assert gone["raised_ns"] == begun


def test_try_refuses_what_is_of_another_machine(
    config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = config.read_text(encoding="utf-8")
    other = tmp_path / "other.toml"
    other.write_text(text.replace('unit = "m"', 'unit = "strokes"'), encoding="utf-8")
    code, _, err = deltak(capsys, "limits", config, "--try", other)
    assert code == 2
    assert "in N/m in the store" in err
    other.write_text(text[: text.index("[[alarm]]")] + text[text.index("[[source]]") :], encoding="utf-8")
    assert deltak(capsys, "limits", config, "--try", other)[0] == 2
    assert deltak(capsys, "limits", config, "--try", config, "--write")[0] == 2


def test_edit_that_cannot_be_placed_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no place for the limit"):
        with_limits(
            'alarm = []\n[rig]\nname = "a"\n', {"k1": {"limit": np.float64(1.5)}}, tmp_path / "a.toml"
        )
