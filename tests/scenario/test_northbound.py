"""A running agent brings its rows to a broker, shows it in status, and takes up a consumer by a reload."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.northbound.line import mosquitto
from tests.northbound.test_mqtt import subscriber
from tests.peers import ROOT
from tests.scenario.live import agent, example, rows, wait_until
from tests.sim.rigs import simulator

NUMBERS = """SELECT e.seq FROM hops h CROSS JOIN estimates e
  ON e.seq BETWEEN h.seq * 1024 AND h.seq * 1024 + 1023
 CROSS JOIN fits f ON f.seq = e.fit_id WHERE h.span = 0 AND f.chosen = 1"""


def asked(*words: str) -> str:
    command = [sys.executable, "-m", "agent", *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True).stdout


@pytest.mark.soak
def test_agent_supplies_a_consumer_that_a_reload_brings(tmp_path: Path) -> None:
    with mosquitto(tmp_path) as port, subscriber(port) as seen:
        text = example("modbus", tmp_path).read_text(encoding="utf-8")
        north = f'\n[[north]]\nname = "plant"\nkind = "mqtt"\nurl = "mqtt://127.0.0.1:{port}"\n'
        db = tmp_path / "live.db"
        with (
            simulator(tmp_path, text, "--scenario", "default") as device,
            agent(device.config, options=["--db", str(db)]) as running,
        ):
            wait_until(
                lambda: rows(db, "SELECT 1 FROM hops LIMIT 1") != [] if db.exists() else False, "rows", 60
            )
            with device.config.open("a", encoding="utf-8") as file:
                file.write(north)
            asked("reload", str(db))
            wait_until(lambda: len(seen.rows()) > 100, "rows over MQTT", 60)
            (consumer,) = json.loads(asked("status", str(db), "--json"))["north"]
            assert (consumer["name"], consumer["state"]) == ("plant", "ok")
            running.document()
        sent = {row["seq"] for row in seen.rows()}
    stored = {seq for (seq,) in rows(db, NUMBERS)}
    assert sent <= stored
    ((kept,),) = rows(db, "SELECT last_seq FROM consumers WHERE name = 'plant' AND topic = 'estimates'")
    assert {seq for seq in stored if seq <= kept} <= sent
