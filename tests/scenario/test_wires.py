"""The same samples over every wire give the same rows; the kernel's own CAN is held against them in
tests/uml."""

import json
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.evaluation.demo.bus import COARSE
from tests import peers
from tests.peers import ROOT
from tests.scenario import wires
from tests.scenario.traces import Write, bus_writes, forbidden

pytestmark = pytest.mark.realtime

WIRES = "tcp", "rtu", "daemon", "serial", "slcan"


class Played:
    """Every wire played to one agent at once, its writes traced; and the recording of the same integers,
    replayed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.configs = {name: wires.configure(name, folder) for name in WIRES}
        trace = folder / "trace"
        document = wires.run(list(self.configs.values()), folder / "live.db", trace)
        self.documents: Mapping[str, Any] = {run["rig"]: run for run in document["runs"]}
        self.writes: list[Write] = bus_writes(trace)
        wires.write_recording(folder / "same.csv", self.integers("tcp"), COARSE)
        self.recorded = wires.replayed(self.configs["tcp"], folder / "same.csv", folder / "replay.db")

    def integers(self, name: str) -> np.ndarray:
        return wires.integers(self.configs[name].with_name("truth.npz"), COARSE)


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Played:
    peers.program("strace", "strace")
    return Played(tmp_path_factory.mktemp("wires"))


@pytest.mark.parametrize("name", WIRES)
def test_wire_carries_every_sample_of_the_same_integers(played: Played, name: str) -> None:
    samples = played.documents[name]["samples"]
    assert samples == {"received": 3000, "used": 3000, "rejected": {}, "dropped": {}, "gaps": 0}
    np.testing.assert_array_equal(played.integers(name), played.integers("tcp"))


@pytest.mark.parametrize("name", WIRES)
def test_rows_and_alarms_of_a_wire_are_those_of_the_recording(played: Played, name: str) -> None:
    live = wires.outcome(played.folder / "live.db", name)
    assert len(live.rows) == 240
    assert len(live.alarms) == 6
    assert {row["status"] for row in live.rows} >= {"warming", "valid"}
    wires.assert_same(live, played.recorded, wires.NEAR)


def test_kernel_saw_the_agent_write_read_requests_and_handshakes_only(played: Played) -> None:
    assert not forbidden(played.writes)
    kinds = [write.protocol for write in played.writes]
    assert kinds.count("modbus-tcp") > 20
    assert kinds.count("modbus-rtu") > 20
    assert kinds.count("socketcand") == 2
    assert set(kinds) == {"modbus-tcp", "modbus-rtu", "socketcand"}
    assert (
        len({write.where for write in played.writes}) == 3
    )  # nothing at all went to the serial line and the adapter


@pytest.mark.parametrize(
    ("bus", "scenario", "words"),
    [
        ("can", "default", r"socketcand on 127\.0\.0\.1:\d+|CAN on the kernel's vcan0"),
        ("serial", "paper", "serial line on a pseudo-terminal, /.*demo.tty"),
    ],
)
def test_demo_on_a_bus_finds_what_was_played(tmp_path: Path, bus: str, scenario: str, words: str) -> None:
    command = [
        "demo",
        "--bus",
        bus,
        "--scenario",
        scenario,
        "--fast",
        "--db",
        str(tmp_path / "demo.db"),
        "--json",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "agent", *command],
        cwd=ROOT, capture_output=True, text=True, check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert done.stderr.splitlines()[0] == f"bus: {document['bus']}"
    assert re.search(words, document["bus"])
    assert_demo_held(document)


def assert_demo_held(document: Mapping[str, Any]) -> None:
    """3000 samples received and used, estimates within 3 sd of the truth, the schedule's alarms alone."""
    samples = document["samples"]
    assert samples == {"received": 3000, "used": 3000, "rejected": {}, "dropped": {}, "gaps": 0}
    for segment in document["truth"]:
        for name, found in segment["parameters"].items():
            assert found["status"] == "valid", (segment["from_s"], name)
            assert abs(found["error_sd"]) <= 3.0, (segment["from_s"], name, found)
    due = [(change["parameter"], change["changed_s"]) for change in document["alarm_delays"]]
    assert due == [("k1", 0.0), ("k2", 0.0), ("B1", 1.0), ("B2", 1.0), ("k1", 2.0), ("k2", 2.0)]
    assert len(document["alarms"]) == len(due)
    assert all(0.0 < change["delay_s"] < 1.0 for change in document["alarm_delays"])
