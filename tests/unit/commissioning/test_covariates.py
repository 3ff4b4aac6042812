"""Baselines of machines whose springs follow a covariate: what is learnt, refused in a sentence, shown."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.app import app
from agent.cli.terminal.errors import guarded
from agent.records import CovariateMean
from agent.storage.write.store import Store
from agent.types import FloatArray
from tests.peers import ROOT
from tests.storage.rows import START, batch, run_info, select

DAYS, STEP = 4, 10
MINUTE = 60 * 10**9
GRAPH = "spring k1 ground-m1; spring k2 m1-m2; damper B1 ground-m1; damper B2 m1-m2"
TRUTH = np.array([25.0, 100.0])
PER_UNIT = np.array([-0.075, 0.0])
RIG = "two-mass-rig"
Hall = Callable[[FloatArray], FloatArray]
SOURCE = """
[[source]]
name = "thermometer"
driver = "modbus"
mode = "poll"
transport = "tcp"
host = "127.0.0.1"
port = 1503
period_s = 60.0
stale_s = 600.0
fields = [{ name = "T", address = 0, type = "int16" }]
map = { hall = "T" }
"""


def swings(t: FloatArray) -> FloatArray:
    """A hall that is warm by day and follows a weather of three days; t in minutes."""
    return 20.0 + 6.0 * np.sin(t / 1440 * 2 * np.pi) + 4.0 * np.sin(t / 4000 * 2 * np.pi)


def stored(
    path: Path, covariates: dict[str, Hall], seed: int = 0, first: int = 0, **absent: tuple[int, int]
) -> Path:
    """Rows each 10 min of springs of which k1 follows the hall at once; means of covariates unless they are
    absent."""
    rng = np.random.default_rng(seed)
    t = first + np.arange(0, DAYS * 1440, STEP)
    hall = covariates["hall"](t - 2.0) - 20.0 if "hall" in covariates else np.zeros(len(t))
    value = TRUTH + np.outer(hall, PER_UNIT) + 0.004 * TRUTH * rng.standard_normal((len(t), 2))
    sd = np.broadcast_to(0.004 * TRUTH, value.shape)
    rows = batch(len(t), parameters=("k1", "k2"), value=value, sd=sd, reference=TRUTH, rig=RIG)
    rows = replace(rows, t_ns=START + t * MINUTE, sd_repeat=sd, lower=value - 2 * sd, upper=value + 2 * sd)
    means = [
        CovariateMean(
            RIG, name, "degC", int(START + minute * MINUTE), float(hall_of(np.array(float(minute)))), 5
        )
        for name, hall_of in covariates.items()
        for minute in range(first, first + DAYS * 1440, STEP // 2)
        if not absent.get(name, (0, 0))[0] <= minute < absent.get(name, (0, 0))[1]
    ]
    with Store.open(path) as store:
        store.write(store.begin_run(replace(run_info(rig=RIG), graph=GRAPH)), [rows, *means])
    return path


def deltak(capsys: pytest.CaptureFixture[str], *argv: object) -> tuple[int, str, str]:
    capsys.readouterr()
    code = guarded(app, [str(word) for word in argv])
    return (code, *capsys.readouterr())


def learnt(capsys: pytest.CaptureFixture[str], *argv: object) -> dict[str, Any]:
    code, out, err = deltak(capsys, "baseline", "learn", *argv, "--json")
    assert code == 0, err
    document: dict[str, Any] = json.loads(out)
    return document


def refused(capsys: pytest.CaptureFixture[str], db: Path, *argv: object) -> str:
    """Return the words with which learning is refused; nothing is stored."""
    before = select(db, "SELECT count(*) FROM v_baselines")
    code, _, err = deltak(capsys, "baseline", "learn", *argv)
    assert code == 2
    assert select(db, "SELECT count(*) FROM v_baselines") == before
    return err


def test_learn_finds_the_dependence_of_one_part_and_none_of_the_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings})
    found = learnt(capsys, db)["parameters"]
    (k1,), (k2,) = found["k1"]["covariates"], found["k2"]["covariates"]
    assert (k1["used"], k2["used"]) == (True, False)
    assert k1["lower"] < -0.075 < k1["upper"]
    assert k2["lower"] < 0.0 < k2["upper"]
    assert k1["lag_s"] < 1800.0
    assert found["k1"]["reference"] == pytest.approx(25.0 - 0.075 * (k1["center"] - 20.0), abs=0.02)
    assert found["k1"]["spread_sd"] < 0.05  # 0.4 with the hall's part in it
    code, out, _ = deltak(capsys, "baseline", "show", db)
    assert code == 0
    assert "what references depend on" in out
    assert "no dependence is seen" in " ".join(out.split())

    # a repair of k1: the dependence of k2 and its reference stay as they were
    before = select(db, "SELECT baseline_id, covariates FROM v_baselines WHERE newest AND parameter = 'k2'")
    stored(db, {"hall": swings}, seed=1, first=DAYS * 1440)
    learnt(capsys, db, "--parameter", "k1", "--since", "4d")
    assert (
        select(db, "SELECT baseline_id, covariates FROM v_baselines WHERE newest AND parameter = 'k2'")
        == before
    )
    assert select(db, "SELECT count(*) FROM v_baselines WHERE parameter = 'k1'") == [(2,)]


def test_trend_takes_the_hall_out_before_it_asks_and_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    warming = lambda t: 20.0 + 0.3 * np.sin(t / 1440 * 2 * np.pi) + t / 1440 * 4.0  # noqa: E731 - a hall
    db = stored(tmp_path / "rig.db", {"hall": warming})
    code, out, _ = deltak(capsys, "trend", db, "k1", "--json")
    plain = json.loads(out)
    assert (code, plain["covariates"], plain["words"].split(",")[0]) == (0, [], "falls")
    (before,) = json.loads(deltak(capsys, "fleet", db, "--parameter", "k1", "--json")[1])["rows"]
    assert (before["trend"], before["covariates"]) == (True, [])
    learnt(capsys, db)
    (row,) = json.loads(deltak(capsys, "fleet", db, "--parameter", "k1", "--json")[1])["rows"]
    assert (row["trend"], row["covariates"]) == (False, ["hall"])
    found = json.loads(deltak(capsys, "trend", db, "k1", "--json")[1])
    assert found["covariates"] == ["hall"]
    assert found["words"] == "no trend"
    assert found["references"] == [found["references"][0]]
    words = deltak(capsys, "trend", db, "k1")[1]
    assert "what hall does is taken out" in words
    assert json.loads(deltak(capsys, "trend", db, "k2", "--json")[1])["covariates"] == []


def test_covariates_that_teach_nothing_are_refused_in_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    still = stored(tmp_path / "still.db", {"hall": lambda t: 20.0 + 0.0 * t})
    assert "hall never moved in this stretch: it is 20 degC throughout" in refused(capsys, still, still)
    absent = stored(tmp_path / "absent.db", {"hall": swings}, hall=(600, 600 + 3 * 1440))
    assert "hall is missing in" in refused(capsys, absent, absent)
    twice = stored(tmp_path / "twice.db", {"hall": swings, "roof": lambda t: 2.0 * swings(t)})
    assert "hall and roof move together" in refused(capsys, twice, twice)


def test_classes_that_the_machine_has_not_run_in_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8")
    hall = '[[channel]]\nname = "hall"\nrole = "covariate"\nunit = "degC"\nrange = [10.0, 60.0]\n'
    config = tmp_path / "rig.toml"
    config.write_text(f"{text}\n{hall}\n{SOURCE}\n", encoding="utf-8")
    db = stored(tmp_path / "two-mass-rig.db", {"hall": swings})
    words = refused(capsys, db, config)
    assert (
        "not yet: the machine has run in 2 of 5 hall classes (40 %); not in 30 to 40, 40 to 50, 50 to"
        in words
    )
    config.write_text(
        f"{text}\n{hall}\n{SOURCE}\n[baseline]\ncovariates = []\ndays = 2.0\n", encoding="utf-8"
    )
    assert learnt(capsys, config)["parameters"]["k1"]["covariates"] == []


def test_gap_of_hours_teaches_nothing_and_spoils_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings}, hall=(1000, 1700))
    (one,) = learnt(capsys, db, "--parameter", "k1")["parameters"]["k1"]["covariates"]
    assert one["lower"] < -0.075 < one["upper"]
    assert select(db, "SELECT n FROM v_baselines")[0][0] < DAYS * 144 - 50


def test_import_of_a_dependence_on_what_the_rig_has_not_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings})
    learnt(capsys, db)
    assert deltak(capsys, "baseline", "export", db, "--to", tmp_path / "b.json")[0] == 0
    config = tmp_path / "rig.toml"
    config.write_text((ROOT / "deploy/examples/modbus.toml").read_text(encoding="utf-8"), encoding="utf-8")
    code, _, err = deltak(capsys, "baseline", "import", config, tmp_path / "b.json")
    assert code == 2
    assert "k1 depends on hall there, which is no covariate here" in err
