"""What a run remembers of itself for the document at its end."""

from pathlib import Path

import pytest

from agent.blocks.constants_watch import SOURCE
from agent.config import load
from agent.records import HealthEvent
from agent.runtime import results
from agent.runtime.results import RunSummary
from agent.types import AlarmTransition
from tests.scenario.live import example


def test_summary_of_a_run_of_years_holds_its_newest_alarms_and_advice_and_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "MOST_REPORTED", 10)
    summary = RunSummary(load(example("modbus", tmp_path)))
    for t_ns in range(25):
        raised = AlarmTransition("rig", "level", "k1", "high", t_ns, "NORM", "UNACK", "raise", "k1 fell")
        over = AlarmTransition("rig", "level", "k1", "high", t_ns, "UNACK", "RTNUN", "clear", "k1 is back")
        summary.take([raised, over, HealthEvent("rig", SOURCE, t_ns, "mass", f"advice {t_ns}")])
    document = summary.document(1.0)
    assert [alarm["raised_ns"] for alarm in document["alarms"]] == list(range(15, 25))
    assert {alarm["state"] for alarm in document["alarms"]} == {"RTNUN"}
    assert document["advice"] == [f"advice {t_ns}" for t_ns in range(15, 25)]
