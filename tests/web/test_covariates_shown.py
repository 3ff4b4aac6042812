"""What the page and the terminal say of covariates: the newest reading, its age, and what follows it."""

import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from agent.cli.glance.files import several
from agent.cli.glance.frame import frame
from agent.cli.glance.state import overview
from agent.commissioning.baseline.learn import Stretch, learn
from agent.records import CovariateMean
from agent.storage.write.store import Store
from tests.storage.rows import START, run_info
from tests.unit.commissioning.test_covariates import DAYS, GRAPH, MINUTE, RIG, stored, swings


def test_overview_says_what_surrounds_a_rig_and_which_references_follow_it(tmp_path: Path) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings})
    end = START + DAYS * 1440 * MINUTE
    (hall,) = overview(several([db], []), end)["rigs"][0]["covariates"]
    assert (hall["covariate"], hall["unit"], hall["stale"]) == ("hall", "degC", False)
    assert hall["value"] == pytest.approx(float(swings(DAYS * 1440.0 - 5)), abs=0.01)
    assert hall["age_s"] == 240.0
    assert hall["words"] == "no reference follows it"
    learn(db, None, Stretch())
    (hall,) = overview(several([db], []), end)["rigs"][0]["covariates"]
    (k1,) = hall["compensates"]
    assert k1["parameter"] == "k1"
    assert k1["percent"] == pytest.approx(-0.3, rel=0.1)
    assert hall["words"].startswith("taken out of k1 by -0.")
    assert not hall["stale"]
    (later,) = overview(several([db], []), end + 24 * 60 * MINUTE)["rigs"][0]["covariates"]
    assert later["stale"]


def test_covariate_of_a_baseline_that_is_not_read_any_more_is_named(tmp_path: Path) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings})
    learn(db, None, Stretch())
    late = CovariateMean(RIG, "roof", "degC", START + 3 * DAYS * 1440 * MINUTE, 5.0, 1)
    with Store.open(db) as store:
        store.write(store.begin_run(replace(run_info(rig=RIG), graph=GRAPH)), [late])
    hall, roof = overview(several([db], []), late.t_ns + 2 * MINUTE)["rigs"][0]["covariates"]
    assert (hall["value"], hall["age_s"], hall["unit"], hall["stale"]) == (None, None, "degC", True)
    assert (roof["value"], roof["stale"], roof["compensates"]) == (5.0, False, [])


def test_watch_shows_what_surrounds_a_rig_and_how_old_it_is(tmp_path: Path) -> None:
    db = stored(tmp_path / "rig.db", {"hall": swings})
    learn(db, None, Stretch())
    console = Console(width=80, file=io.StringIO(), record=True)
    end = START + DAYS * 1440 * MINUTE
    for minutes in (0, 24 * 60):
        console.print(frame(overview(several([db], []), end + minutes * MINUTE), "12:00"))
    fresh, late = [line for line in console.export_text().splitlines() if line.strip().startswith("hall ")]
    value = f"{float(swings(DAYS * 1440.0 - 5)):.2f} degC"
    assert value in fresh
    assert "4 min ago" in fresh
    assert "taken out of k1 by -0." in fresh
    assert "24 h ago" in late


def test_watch_shows_a_covariate_that_was_never_read(tmp_path: Path) -> None:
    found = overview(several([stored(tmp_path / "rig.db", {"hall": swings})], []), START)
    never = {"value": None, "age_s": None, "stale": True}
    found["rigs"][0]["covariates"] = [row | never for row in found["rigs"][0]["covariates"]]
    console = Console(width=80, file=io.StringIO(), record=True)
    console.print(frame(found, "12:00"))
    assert "hall        -       never   no reference follows it" in console.export_text()
