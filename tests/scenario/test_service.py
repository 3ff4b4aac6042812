"""`deltak run` as a service: how it ends, several rigs and sources, buses that go away, threads that die."""

import json
import re
import signal
import threading
from pathlib import Path

import pytest

from agent.config import load
from agent.runtime.service import Service
from tests.ports import free_port
from tests.scenario.live import Agent, agent, example, hops, rows, wait_until
from tests.sim.rigs import Simulator, simulator

pytestmark = pytest.mark.realtime

STEADY = ("--scenario", "steady")


def renamed(text: str, name: str, port: int) -> str:
    """Return an example's text for another rig behind another port, with the same store."""
    text = text.replace('name = "two-mass-rig"', f'name = "{name}"')
    return re.sub(r"(?m)^port = \d+", f"port = {port}", text)


def test_run_ends_with_sigterm_exit_0_and_a_complete_document(tmp_path: Path) -> None:
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    with (
        simulator(tmp_path, text, *STEADY) as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) >= 10, "ten rows")
        document = running.document()
    assert document["samples"]["used"] == document["samples"]["received"] >= 450
    assert set(document["estimates"]) == {"k1", "k2", "B1", "B2"}
    # what the document counts is in the file: everything acknowledged is committed
    assert rows(db, "SELECT max(used) FROM v_health")[0][0] == document["samples"]["used"]
    assert hops(db) == document["windows"]


def test_run_ends_with_sigint_exit_130(tmp_path: Path) -> None:
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    with (
        simulator(tmp_path, text, *STEADY) as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) >= 2, "two rows")
        assert running.end(signal.SIGINT) == 130
    assert "Traceback" not in running.err


def test_run_duration_ends_by_itself_with_exit_0(tmp_path: Path) -> None:
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    options = ["--db", str(db), "--duration", "1.5"]
    with simulator(tmp_path, text, *STEADY) as device, agent(device.config, options=options) as running:
        assert running.end() == 0, running.err
    document = json.loads(running.out)
    assert 1.4 <= document["seconds"] <= 6.0
    assert document["samples"]["used"] > 500


def test_two_rigs_with_one_store_share_a_writer_and_keep_apart(tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text()
    folders = [tmp_path / name for name in ("left", "right")]
    devices = []
    for folder in folders:
        folder.mkdir()
        shared = renamed(text, folder.name, free_port()).replace(
            'path = "two-mass-rig.db"', 'path = "../shared.db"'
        )
        devices.append(Simulator(folder, shared, *STEADY))
    db = tmp_path / "shared.db"
    try:
        configs = [device.ready().config for device in devices]
        with agent(*configs) as running:
            wait_until(lambda: min(hops(db, "left"), hops(db, "right")) >= 5, "rows of both")
            document = running.document()
    finally:
        assert [device.stop() for device in devices] == [0, 0]
    assert [run["rig"] for run in document["runs"]] == ["left", "right"]
    assert all(run["samples"]["used"] == run["samples"]["received"] > 0 for run in document["runs"])
    assert all(run["db"] == str(db) for run in document["runs"])
    assert rows(db, "SELECT rig FROM v_runs ORDER BY rig") == [("left",), ("right",)]


def test_two_sources_of_one_rig_are_joined_sample_by_sample(tmp_path: Path) -> None:
    """Force from one device, motion from another; their samples meet by their numbers."""
    text = example("modbus", tmp_path).read_text()
    source = text[text.index("[[source]]") : text.index("[store]")]
    head, tail = text.split(source)
    second = re.sub(r"(?m)^port = \d+", f"port = {free_port()}", source).replace(
        "map = { force", 'map = { x1 = "x1", x2 = "x2" } # { force'
    )
    first = source.replace("map = { force", 'map = { force = "force" } # { force')
    db = tmp_path / "rig.db"
    scenario = tmp_path / "short.toml"
    scenario.write_text(
        'duration_s = 2.0\n[[force]]\nkind = "random"\nrms = 5.0\n[noise]\ndisplacement = 1e-6\n'
    )
    both = head + first + second + tail
    with (
        simulator(tmp_path, both, "--scenario", str(scenario)) as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) >= 40, "forty rows")
        document = running.document()
    assert document["samples"]["gaps"] == 0
    assert document["samples"]["received"] == 4000
    ledgers = rows(
        db, "SELECT source, max(received), max(used) FROM v_health GROUP BY source ORDER BY source"
    )
    assert ledgers == [("modbus", 2000, 2000), ("modbus-2", 2000, 2000)]
    assert document["estimates"]["k2"]["status"] == "valid"
    assert abs(document["estimates"]["k2"]["value"] - 100.0) <= 4 * document["estimates"]["k2"]["sd"]


def test_refusing_port_is_tried_again_while_a_source_alarm_stands(tmp_path: Path) -> None:
    config, db = example("modbus", tmp_path), tmp_path / "rig.db"
    text = config.read_text()
    with agent(config, options=["--db", str(db)]) as running:
        wait_until(
            lambda: rows(db, "SELECT 1 FROM v_alarms WHERE kind = 'source' AND state = 'UNACK'") != [],
            "alarm",
        )
        with simulator(tmp_path, text, *STEADY):
            wait_until(lambda: hops(db) >= 5, "rows once the device is there")
            wait_until(
                lambda: rows(db, "SELECT 1 FROM v_alarms WHERE cleared_at IS NOT NULL") != [], "alarm cleared"
            )
            document = running.document()
    (alarm,) = (found for found in document["alarms"] if found["kind"] == "source")
    assert (alarm["parameter"], alarm["state"]) == ("modbus", "RTNUN")
    assert document["samples"]["used"] > 0


def test_server_that_dies_and_returns_is_a_gap_and_an_alarm_that_clears(tmp_path: Path) -> None:
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    query = "SELECT count(*) FROM v_alarms WHERE kind = 'source' AND cleared_at IS"
    with simulator(tmp_path, text, *STEADY) as first:
        running = Agent([first.config], "--db", str(db))
        try:
            wait_until(lambda: hops(db) >= 10, "rows of the first device")
            first.process.kill()
            first.end()
            wait_until(lambda: rows(db, f"{query} NULL") == [(1,)], "the source's alarm")
            before = hops(db)
            with simulator(tmp_path, text, *STEADY):
                wait_until(lambda: hops(db) >= before + 10, "rows of the second device")
                wait_until(lambda: rows(db, f"{query} NOT NULL") == [(1,)], "the alarm cleared")
                document = running.document()
        finally:
            if running.process.poll() is None:
                running.process.kill()
                running.process.communicate()
    samples = document["samples"]
    assert samples["gaps"] >= 1
    lost = sum(samples["rejected"].values()) + sum(samples["dropped"].values())
    assert samples["received"] == samples["used"] + lost


def test_reader_that_dies_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fault in a driver ends its thread, not the agent: a source alarm says so."""
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    monkeypatch.setattr("drivers.modbus.driver.ModbusDriver.read", lambda *_: 1 / 0)
    monkeypatch.setattr(threading, "excepthook", lambda _args: None)
    with simulator(tmp_path, text, *STEADY) as device:
        service = Service([load(device.config)], db, "live")
        thread = threading.Thread(target=service.run, args=(None,))
        thread.start()
        try:
            found = "SELECT parameter, message FROM v_alarms WHERE kind = 'source'"
            wait_until(lambda: rows(db, found) != [], "an alarm")
        finally:
            service.stop()
            thread.join(30.0)
    ((source, message),) = rows(db, found)
    assert source == "modbus"
    assert "division by zero" in message
