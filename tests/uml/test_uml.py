"""Device, agent and can-utils over the kernel's own CAN: here where it has vcan, else in a guest."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.evaluation.demo.bus import COARSE
from agent.storage.read import queries
from tests.peers import ROOT, program
from tests.scenario import wires
from tests.uml.inside import SAME_ARITHMETIC
from tests.vcan import guest
from tests.vcan.test_vcan import kernel_has_vcan

COMMAND = [sys.executable, "-m", "tests.uml.inside"]
LIMIT_S = 180.0
pytestmark = [pytest.mark.realtime, pytest.mark.timeout(LIMIT_S + 20.0)]
HEALTHY = {"rejected": {}, "dropped": {}, "gaps": 0}


class Left:
    """What the run on the kernel's buses left behind."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.db = folder / "live.db"
        runs = json.loads((folder / "run.json").read_text())["runs"]
        self.runs: Mapping[str, Any] = {run["rig"]: run for run in runs}
        self.frames = [
            line.split()[2].split("#") for line in (folder / "candump.log").read_text().splitlines()
        ]
        self.recording = next((folder / "live.db.raw").glob("*.log"))
        self.integers = wires.integers(folder / "truth.npz", COARSE)


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Left:
    for name in ("candump", "cangen", "canplayer"):
        program(name, "can-utils")
    folder = tmp_path_factory.mktemp("left")
    if kernel_has_vcan():
        environment = os.environ | {"RESULTS": str(folder)}
        done = subprocess.run(
            COMMAND, cwd=ROOT, env=environment, capture_output=True, timeout=LIMIT_S, check=False
        )
        status, output = done.returncode, done.stderr.decode()
    else:
        status, output = guest.run(COMMAND, ROOT, LIMIT_S, folder)
    assert status == 0, output
    return Left(folder)


def test_ten_seconds_at_one_kilohertz_arrive_without_loss(left: Left) -> None:
    assert left.runs["played"]["samples"] == {"received": 10_000, "used": 10_000, **HEALTHY}


def test_candump_saw_what_the_device_played_and_nothing_of_the_agent(left: Left) -> None:
    data = np.frombuffer(
        bytes.fromhex("".join(data for number, data in left.frames if number == "100")), "<i2"
    )
    np.testing.assert_array_equal(data.reshape(-1, 4)[:, 1:], left.integers)
    assert {number for number, _ in left.frames} == {"100", "5A5"}  # the device's and cangen's


def test_rows_and_alarms_on_vcan_are_those_of_the_recording(left: Left, tmp_path: Path) -> None:
    wires.write_recording(tmp_path / "same.csv", left.integers, COARSE)
    config, files = wires.configure("daemon", tmp_path), (tmp_path / "same.csv", tmp_path / "replay.db")
    recorded = wires.replayed(config, *files, SAME_ARITHMETIC)
    live = wires.outcome(left.db, "played")
    assert len(live.rows) == 800
    assert len(live.alarms) == 4
    wires.assert_same(live, recorded, wires.NEAR)


def test_recording_is_to_the_letter_what_candump_took_down_of_the_device(left: Left) -> None:
    recorded = left.recording.read_text(encoding="ascii").splitlines()
    lines = [
        line
        for line in (left.folder / "candump.log").read_text(encoding="ascii").splitlines()
        if " 100#" in line
    ]
    assert len(recorded) == 10_000
    # a busy machine makes candump itself lose frames; what it took down is ours, in its order, to the
    # microsecond
    ours = iter(recorded)
    assert all(line in ours for line in lines)
    assert len(lines) > 5000


def test_recording_from_vcan_replays_to_the_rows_and_alarms_of_the_live_run(
    left: Left, tmp_path: Path
) -> None:
    config = wires.configure("daemon", tmp_path)
    replayed = wires.replayed(config, left.recording, tmp_path / "replay.db", SAME_ARITHMETIC)
    live = wires.outcome(left.db, "played")
    assert len(live.rows) == 800
    wires.assert_same(live, replayed, wires.NEAR)
    times = "SELECT t_ns FROM v_estimates WHERE rig = ? ORDER BY t_ns, parameter"
    with closing(wires.opened(left.db)) as ours, closing(wires.opened(tmp_path / "replay.db")) as theirs:
        first, second = (
            ours.execute(times, ("played",)).fetchall(),
            theirs.execute(times, ("daemon",)).fetchall(),
        )
    assert list(map(tuple, first)) == list(map(tuple, second))


def test_what_canplayer_sends_gives_the_rows_of_the_device_itself(left: Left) -> None:
    assert left.runs["canplayer"]["samples"] == {"received": 3000, "used": 3000, **HEALTHY}
    first, again = wires.outcome(left.db, "played"), wires.outcome(left.db, "canplayer")
    assert len(again.rows) == 240
    wires.assert_same(
        wires.Outcome(first.rows[:240], ()), wires.Outcome(again.rows, again.alarms), wires.NEAR
    )


def test_bus_that_goes_and_returns_is_read_again_within_two_seconds(left: Left) -> None:
    events = queries.events(left.db, "shaken")
    assert [event["cause"] for event in events] == ["lost", "recovered"] * 2
    down, gone = (event["message"] for event in events[::2])
    assert down == "vcan2: Network is down"
    assert gone in {"vcan2: Network is down", "vcan2: No such device"}  # one that is deleted goes down first
    back = json.loads((left.folder / "back.json").read_text())
    for returned, event in zip(back.values(), events[1::2], strict=True):
        assert 0.0 < (event["t_ns"] - returned) / 1e9 <= 2.0


def test_frames_lost_with_the_bus_are_two_gaps_and_two_source_alarms(left: Left) -> None:
    samples = left.runs["shaken"]["samples"]
    assert samples["received"] == samples["used"] > 1000
    assert samples["gaps"] == 2
    with closing(wires.opened(left.db)) as connection:
        query = "SELECT kind, parameter, state FROM v_alarms WHERE rig = 'shaken' AND kind = 'source'"
        found = [tuple(row) for row in connection.execute(query)]
    assert found == [("source", "can", "RTNUN")] * 2
