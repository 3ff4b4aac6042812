"""Alarms outlive the process that raised them."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from agent.config import load
from agent.records import Record, RunInfo
from agent.runtime.rig_runtime import RigRuntime
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import AlarmTransition
from drivers.reconnect import LinkEvent
from tests.peers import ROOT


def _run(rig: str) -> RunInfo:
    return RunInfo(rig, "live", 1_000, "0", "0" * 64)


def _raised(rig: str, kind: str, parameter: str) -> AlarmTransition:
    return AlarmTransition(
        rig=rig, kind=kind, parameter=parameter, priority="high", t_ns=2_000, from_state="NORM",  # type: ignore[arg-type]
        to_state="UNACK", cause="raise", message="",
    )  # fmt: skip


@pytest.fixture
def standing(tmp_path: Path) -> StoreWriter:
    """A writer that was started on a file in which an earlier live run left two alarms standing."""
    config = load(ROOT / "deploy/examples/modbus.toml")
    rig, db = config.rig.name, tmp_path / "rig.db"
    with Store.open(db) as store:
        run_id = store.begin_run(_run(rig))
        store.write(
            run_id, [_raised(rig, "level", config.alarm[0].parameter), _raised(rig, "source", "modbus")]
        )
    writer = StoreWriter(lambda: Store.open(db), [_run(rig)])
    writer.start()
    writer.stop()
    return writer


def test_rig_started_again_goes_on_with_its_standing_alarms(standing: StoreWriter) -> None:
    config = load(ROOT / "deploy/examples/modbus.toml")
    rig = RigRuntime(config, lambda _: None)
    rig.restore(standing.standing[config.rig.name])
    assert rig.pipeline.alarms.states[config.alarm[0].parameter] == "UNACK"


def test_source_that_was_lost_before_a_restart_clears_its_alarm_at_its_first_sample(
    standing: StoreWriter,
) -> None:
    config = load(ROOT / "deploy/examples/modbus.toml")
    published: list[Record] = []

    def publish(records: Sequence[Record]) -> None:
        published.extend(records)

    rig = RigRuntime(config, publish)
    rig.restore(standing.standing[config.rig.name])
    rig.link("modbus", LinkEvent("recovered", "modbus: delivers samples again", 0.0))
    rig.link("modbus", LinkEvent("recovered", "modbus: delivers samples again", 0.0))
    steps = [record for record in published if isinstance(record, AlarmTransition)]
    assert [(step.parameter, step.to_state) for step in steps] == [("modbus", "RTNUN")]
