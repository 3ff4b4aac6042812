"""The running agent makes forecasts beside its work, and ends without waiting for them."""

import signal
import time
from pathlib import Path

import pytest

from tests.scenario.live import agent, example, rows, wait_until
from tests.sim.rigs import simulator

pytestmark = pytest.mark.realtime


def test_agent_stores_forecasts_while_it_runs_and_ends_at_once(tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text() + '\n[forecast]\nevery = "1s"\n'
    db = tmp_path / "rig.db"
    query = "SELECT count(*) FROM v_forecast WHERE rig = 'two-mass-rig' AND cause = 'due'"
    options = ["--db", str(db)]
    with (
        simulator(tmp_path, text, "--scenario", "steady") as device,
        agent(device.config, options=options) as running,
    ):
        wait_until(lambda: db.exists() and rows(db, query)[0][0] >= 1, "a forecast")
        begun = time.monotonic()
        assert running.end(signal.SIGTERM) == 0, running.err
        assert time.monotonic() - begun < 4.0
    ((used, received),) = rows(db, "SELECT max(used), max(received) FROM v_health")
    assert used == received
    assert rows(db, "SELECT count(*) FROM v_events WHERE source = 'forecast'") == [(0,)]
    assert rows(db, "SELECT DISTINCT code_version IS NOT NULL, made_at_ns > 0 FROM v_forecast") == [(1, 1)]
