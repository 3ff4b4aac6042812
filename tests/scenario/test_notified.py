"""The running agent notifies its targets; one that hangs costs neither a row nor the time to end."""

import time
from pathlib import Path

from tests.scenario.live import agent, example, rows, wait_until
from tests.sim.rigs import simulator

TABLES = """
[[notify]]
name = "shift"
kind = "command"
command = ["sh", "-c", "echo $DELTAK_IDEMPOTENCY_KEY $DELTAK_TO_STATE >> keys"]

[[notify]]
name = "hung"
kind = "command"
command = ["sleep", "60"]
"""
EVENTS = """SELECT m.rig || '-' || e.id || '-' || e.t_ns, e.to_state FROM v_alarm_events e
            JOIN v_alarms m ON m.id = e.alarm_id ORDER BY e.id"""
DONE = "SELECT count(*) FROM v_notifications WHERE target = 'shift' AND state = 'done'"


def test_agent_notifies_of_every_step_in_order_while_another_target_hangs(tmp_path: Path) -> None:
    config = example("modbus", tmp_path)
    text = config.read_text(encoding="utf-8") + TABLES
    db = tmp_path / "live.db"
    with (
        simulator(tmp_path, text, "--scenario", "default", "--fast") as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(
            lambda: rows(db, DONE)[:1] >= [(6,)] if rows(db, "SELECT 1 FROM v_runs") else False, "six steps"
        )
        begun = time.monotonic()
        running.document()
        assert time.monotonic() - begun < 5.0
    done = rows(
        db, "SELECT alarm_event_id FROM v_notifications WHERE target = 'shift' AND state = 'done' ORDER BY id"
    )
    sent = [line.split() for line in (tmp_path / "keys").read_text(encoding="utf-8").splitlines()]
    assert sent[: len(done)] == [list(event) for event in rows(db, EVENTS)][: len(done)]
    assert rows(db, "SELECT DISTINCT state FROM v_notifications WHERE target = 'hung'") == [("pending",)]
