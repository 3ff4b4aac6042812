"""Some rigs of one database leave and enter while the others go on; the rows of all are where they belong."""

from pathlib import Path

import pytest

from agent.errors import StoreError
from agent.storage.operations import command_alarms
from agent.storage.write.alarm_commands import Request
from agent.storage.write.retention import Density, Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import HOP, START, batch, run_info, select, step

KEEP = Retention(60.0, 3600.0, float("inf"), 2e6)
ROWS = "SELECT count(DISTINCT t_ns) FROM v_estimates_windows WHERE run_id = ?"


def rows(path: Path, run_id: int) -> int:
    return int(select(path, ROWS, run_id)[0][0])


def test_exchange_ends_one_run_whole_and_leaves_the_other(tmp_path: Path) -> None:
    path = tmp_path / "both.db"
    writer = StoreWriter(lambda: Store.open(path), [run_info("a"), run_info("b")], every_s=1.0, period_s=60.0)
    writer.start()
    before = dict(writer.run_ids)
    for rig in ("a", "b"):
        writer.publish(
            [batch(50, rig=rig)]
        )  # two periods and a half; the last is kept only at the end of a run
    writer.exchange(
        ["a"], [run_info("a", started_ns=START + 50 * HOP), run_info("c")], Density(1.0, KEEP, 1.0)
    )
    assert writer.run_ids["b"] == before["b"]
    assert writer.run_ids["a"] not in before.values()
    assert (rows(path, before["a"]), rows(path, before["b"])) == (3, 2)
    for rig in ("a", "b"):
        writer.publish([batch(50, first=50, rig=rig)])
    writer.publish([batch(50, rig="gone")])  # what comes late of a rig that left is not taken for a fault
    writer.stop()
    assert writer.broken is None
    assert (rows(path, before["b"]), rows(path, writer.run_ids["a"])) == (5, 3)
    assert select(path, "SELECT count(*) FROM v_runs") == [(4,)]


def test_exchange_with_a_denser_store_keeps_all_from_then_on(tmp_path: Path) -> None:
    path = tmp_path / "dense.db"
    writer = StoreWriter(lambda: Store.open(path), [run_info("a"), run_info("b")], every_s=1.0, period_s=60.0)
    writer.start()
    writer.exchange(["a"], [run_info("a")], Density(0.0, KEEP, 1.0))
    writer.publish([batch(50, rig="b")])
    writer.stop()
    assert rows(path, writer.run_ids["b"]) == 50


def test_exchange_that_ends_with_the_agent_is_refused(tmp_path: Path) -> None:
    writer = StoreWriter(lambda: Store.open(tmp_path / "x.db"), [run_info("a")])
    writer.start()
    writer.stop()
    with pytest.raises(StoreError, match="ending"):
        writer.exchange(["a"], [], Density(0.0, KEEP, 1.0))


def test_alarm_that_stood_over_an_exchange_is_acknowledged_as_it_is_now(tmp_path: Path) -> None:
    path = tmp_path / "alarm.db"
    writer = StoreWriter(lambda: Store.open(path), [run_info()], served={})
    writer.start()
    writer.publish([step("NORM", "UNACK")])
    writer.exchange(["press-7"], [run_info()], Density(0.0, KEEP, 1.0))
    assert [row.state for row in writer.standing["press-7"]] == ["UNACK"]
    writer.publish([step("UNACK", "RTNUN", START + HOP, cause="clear")])
    assert writer.flush()
    command_alarms(path, Request("acknowledge", (1,), "eva"))
    writer.stop()
    assert select(path, "SELECT state FROM v_alarms") == [("NORM",)]
    assert select(path, "SELECT from_state, to_state FROM v_alarm_events ORDER BY id DESC LIMIT 1") == [
        ("RTNUN", "NORM")
    ]
