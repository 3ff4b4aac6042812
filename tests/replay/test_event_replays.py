"""The record that is kept of an alarm replays by itself, and shows the change that raised it."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.runtime import replay
from tests.peers import ROOT
from tests.scenario.live import agent, example, hops, rows, wait_until
from tests.sim.rigs import simulator

HOP_NS = 50_000_000
RAISED = """SELECT a.* FROM v_alarms a JOIN v_alarm_events e ON e.alarm_id = a.id AND e.to_state = 'UNACK'
            WHERE a.kind = 'level' AND a.parameter = ? AND abs(e.t_ns - ?) <= ?"""
KEYS = "every_s = 0\nevents = { before_s = 0.6, after_s = 0.3 }  #"


def configured(bus: str, folder: Path, keys: str = KEYS) -> str:
    example(bus, folder)
    text = (folder / f"{bus}.toml").read_text(encoding="utf-8")
    return text.replace("every_s = 0 ", keys)


@dataclass(frozen=True)
class Live:
    """A live run with alarms, ended."""

    config: Path
    db: Path


@pytest.fixture(scope="module", params=["can"])
def live(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Live:
    folder = tmp_path_factory.mktemp("events")
    db = folder / "live.db"
    with (
        simulator(folder, configured(request.param, folder), "--scenario", "default", "--fast") as device,
        agent(device.config, options=["--db", str(db)]) as running,
    ):
        wait_until(lambda: hops(db) == 60, "60 rows")
        running.document()
    return Live(device.config, db)


def asked(db: Path, query: str, *values: object) -> list[dict[str, Any]]:
    with closing(sqlite3.connect(db)) as connection:
        connection.row_factory = sqlite3.Row
        return [dict(row) for row in connection.execute(query, values)]


def records(live: Live) -> list[dict[str, Any]]:
    return asked(live.db, "SELECT * FROM v_event_records WHERE kind = 'level' ORDER BY id")


def test_every_level_alarm_is_in_a_record_with_its_provenance(live: Live) -> None:
    found = records(live)
    assert len(found) >= 3
    assert {record["state"] for record in found} == {"complete"}
    for alarm in asked(live.db, "SELECT e.t_ns FROM v_alarm_events e JOIN v_alarms a ON a.id = e.alarm_id "
                       "WHERE a.kind = 'level' AND e.to_state = 'UNACK'"):  # fmt: skip
        assert any(record["from_ns"] <= alarm["t_ns"] <= record["to_ns"] for record in found)
    (run,) = asked(live.db, "SELECT * FROM v_runs")
    for record in found:
        assert record["alarm_id"] is not None
        assert (record["config_sha256"], record["code_version"]) == (
            run["config_sha256"],
            run["code_version"],
        )
        with np.load(live.db.parent / record["file"]) as file:
            meta = json.loads(str(file["meta"]))
            assert len(file["t"]) == record["samples"]
        assert meta["config_sha256"] == run["config_sha256"]


def test_record_of_an_alarm_replays_to_the_same_alarm_and_the_same_change(live: Live, tmp_path: Path) -> None:
    record = next(r for r in records(live) if r["parameter"] in {"B1", "B2"})
    db = tmp_path / "event.db"
    document = replay.replay(config=live.config, recordings=[live.db.parent / record["file"]], db=db)
    assert document["samples"]["used"] == record["samples"]
    # Its record begins 0.6 s before the alarm, with another reference: the same alarm may come two hops
    # beside it.
    (again,) = asked(db, RAISED, record["parameter"], record["t_ns"], 2 * HOP_NS)
    (before,) = asked(live.db, "SELECT * FROM v_alarms WHERE id = ?", record["alarm_id"])
    # two estimates, the replayed one without what the live run had learnt before
    assert abs(again["delta"] - before["delta"]) <= 3 * np.hypot(again["sd"], before["sd"])
    shown = (
        "SELECT value, sd FROM v_estimates WHERE parameter = ? "
        "AND status = 'valid' AND t_ns <= ? ORDER BY 1 - t_ns"
    )
    (ours, *_), (theirs, *_) = (
        asked(name, shown, record["parameter"], record["to_ns"]) for name in (db, live.db)
    )
    assert abs(ours["value"] - theirs["value"]) <= 3 * theirs["sd"]


def test_record_replays_with_the_time_stamps_of_the_live_run(live: Live, tmp_path: Path) -> None:
    record = records(live)[1]
    with np.load(live.db.parent / record["file"]) as file:
        stamps, number = file["t"].astype(np.int64), file["index"]
    (first,) = asked(live.db, "SELECT min(t_ns) AS t_ns FROM v_estimates")
    np.testing.assert_array_equal(stamps, first["t_ns"] + (number - 49) * 1_000_000)


def deltak(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "agent", *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=60)


def test_records_are_listed_by_command(live: Live) -> None:
    done = deltak("records", live.db, "--json")
    assert done.returncode == 0, done.stderr
    listed = json.loads(done.stdout)["records"]
    assert [r["file"] for r in listed if r["kind"] == "level"] == [r["file"] for r in records(live)]
    assert listed[0]["file"] in deltak("records", live.db).stdout
    refused = deltak("records", live.db, "--rig", "nobody")
    assert (refused.returncode, refused.stdout) == (2, "")


def test_agent_that_is_killed_during_an_event_keeps_what_was_before_and_says_it_is_cut(
    tmp_path: Path,
) -> None:
    db = tmp_path / "live.db"
    keys = "every_s = 0\nevents = { before_s = 0.6, after_s = 60.0 }  #"
    begun = "SELECT count(*) FROM v_event_records WHERE kind = 'level' AND state = 'recording'"
    with simulator(
        tmp_path, configured("modbus", tmp_path, keys), "--scenario", "default", "--fast"
    ) as device:
        with agent(device.config, options=["--db", str(db)]) as running:
            wait_until(lambda: hops(db) > 0 and rows(db, begun)[0][0] > 0, "a record that is begun")
            os.kill(running.process.pid, signal.SIGKILL)
            running.process.communicate()
        with agent(device.config, options=["--db", str(db)]) as again:
            wait_until(lambda: rows(db, begun)[0][0] == 0, "the record to be cut")
            again.end(signal.SIGTERM)
    first = asked(db, "SELECT * FROM v_event_records ORDER BY id")[0]
    assert (first["state"], first["message"]) == ("cut", "the agent ended before all of it had come")
    with np.load(tmp_path / first["file"]) as file:
        assert json.loads(str(file["meta"]))["state"] == "cut"
        assert file["t"].astype(np.int64)[0] <= first["t_ns"] <= file["t"].astype(np.int64)[-1]
