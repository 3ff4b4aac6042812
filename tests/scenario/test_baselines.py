"""Rows, changes and alarms count from what was learnt of the healthy machine, in replays and in the agent
that runs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.commissioning.baseline.learn import Stretch, learn
from agent.records import Baseline, HealthEvent, Record
from agent.runtime.replay import replay
from agent.runtime.rig_runtime import RigRuntime
from agent.storage.maintenance import store_baselines
from tests.scenario.live import agent, example, rows, wait_until
from tests.scenario.test_bad_input import configuration
from tests.sim.rigs import simulator
from tests.statistical.sensor_faults import healthy

SECOND_H = 1 / 3600
NOMINAL_IS_OFF = {'"m1"], nominal = 25.0': '"m1"], nominal = 20.0'}
SHOWN = "SELECT DISTINCT reference, baseline_id FROM v_estimates WHERE parameter = 'k1'"
GRAPH = "spring k1 ground-m1; spring k2 m1-m2; damper B1 ground-m1; damper B2 m1-m2"


def recording(folder: Path, samples: int = 6000) -> Path:
    force, x1, x2 = healthy(np.random.default_rng(4), samples, 1e-6).T
    np.savez(folder / "fine.npz", t=1e-3 * np.arange(samples), force=force, x1=x1, x2=x2)
    return folder / "fine.npz"


def levels(document: dict[str, Any]) -> list[str]:
    return [alarm["parameter"] for alarm in document["alarms"] if alarm["kind"] == "level"]


def test_alarm_against_a_wrong_nominal_is_gone_once_the_machine_was_learnt(tmp_path: Path) -> None:
    config, db = configuration(tmp_path, 0.5, **NOMINAL_IS_OFF), tmp_path / "rig.db"
    record = recording(tmp_path)
    assert levels(replay(config=config, recordings=[record], db=db)) == ["k1"]
    assert rows(db, SHOWN) == [(20.0, None)]
    found = learn(db, None, Stretch(("k1",), hours=3 * SECOND_H))["parameters"]["k1"]
    assert found["reference"] == pytest.approx(25.0, rel=0.01)
    again = replay(config=config, recordings=[record], db=db)
    assert levels(again) == []
    assert abs(again["estimates"]["k1"]["delta"]) < 0.5
    assert rows(db, SHOWN) == [(found["reference"], found["baseline_id"])]
    # the parts that were not learnt count from nominal as before
    assert rows(db, SHOWN.replace("k1", "k2")) == [(100.0, None)]
    # the newest run says what it was begun with
    assert rows(db, "SELECT baseline_id FROM v_runs ORDER BY run_id") == [(None,), (found["baseline_id"],)]


def test_baseline_of_another_graph_is_not_used_and_that_is_said(tmp_path: Path) -> None:
    config, db = configuration(tmp_path, 0.5), tmp_path / "rig.db"
    replay(config=config, recordings=[recording(tmp_path, 1500)], db=db)
    (rig,) = rows(db, "SELECT name FROM rigs")[0]
    figures = (30.0, 0.1, 0.1, 0.1, None, 1.0, 30.0)
    store_baselines(db, [Baseline(rig, "k1", "N/m", "spring k1 m1-m2", *figures, "[]", 0, 1, 30)])
    document = replay(config=config, recordings=[recording(tmp_path, 1500)], db=db)
    assert any("of another graph (spring k1 m1-m2)" in words for words in document["advice"])
    assert rows(db, SHOWN) == [(25.0, None)]


def test_running_rig_says_once_that_a_baseline_is_in_another_unit(tmp_path: Path) -> None:
    from agent.config import load

    published: list[Record] = []
    rig = RigRuntime(load(example("modbus", tmp_path)), published.extend)
    figures = (30.0, 0.1, 0.1, 0.1, None, 1.0, 30.0)
    wrong = (Baseline("two-mass-rig", "k1", "N/mm", "", *figures, "[]", 0, 1, 30, baseline_id=4),)
    for _ in range(2):
        rig.count_from(wrong)
    (event,) = [record for record in published if isinstance(record, HealthEvent)]
    assert "the baseline of k1 is in N/mm, its estimates are in N/m" in event.message
    rig.pipeline.begin_anew("for this test")
    fine = (Baseline("two-mass-rig", "k1", "N/m", "", *figures, "[]", 0, 1, 30, baseline_id=5),)
    rig.count_from(fine)
    rig.pipeline.begin_anew("for this test")
    labels = rig.pipeline.stages.estimation.labels
    assert labels.baseline_id == (5, None, None, None)
    assert labels.reference.tolist() == [30.0, 100.0, 5.0, 5.0]


@pytest.mark.realtime
def test_agent_that_runs_counts_from_a_baseline_from_its_next_rows_on(tmp_path: Path) -> None:
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    steady = ("--scenario", "steady")
    valid = "SELECT count(DISTINCT t_ns) FROM v_estimates WHERE status = 'valid'"
    with (
        simulator(tmp_path, text, *steady) as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: (rows(db, valid) or [(0,)])[0][0] >= 30, "thirty rows")
        found = learn(db, None, Stretch(("k1",), hours=SECOND_H))["parameters"]["k1"]
        learnt = (
            "SELECT count(*) FROM v_estimates WHERE parameter = 'k1' AND baseline_id = ? AND reference = ?"
        )
        wait_until(
            lambda: rows(db, learnt, found["baseline_id"], found["reference"])[0][0] >= 2, "rows from it"
        )
        running.document()
    assert rows(db, "SELECT graph FROM v_baselines") == [(GRAPH,)]
