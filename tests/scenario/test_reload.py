"""A running agent takes up changed files: rigs that change start anew, the others lose nothing; it says how
it is."""

import json
import os
import re
import signal
import socket
import tarfile
import threading
import urllib.request
from pathlib import Path
from typing import Any, Self

import pytest

from agent.cli.gateway import diag
from agent.cli.gateway.status import reload, status
from agent.errors import ConfigError, StoreError
from tests.ports import free_port
from tests.scenario.live import Agent, agent, example, hops, rows, wait_until
from tests.sim.rigs import simulator

pytestmark = pytest.mark.realtime
SECRET = "hunter2-of-the-press"


class Gateway:
    """An agent on a folder of configurations; both rigs listen to one device, each by a connection of its
    own."""

    def __init__(self, folder: Path, text: str, workers: int = 1) -> None:
        self.workers = workers
        self.folder, self.db, self._text = folder / "conf.d", folder / "all.db", text
        self.folder.mkdir()
        self.port = free_port()
        self.write("left", extra=f'\n[metrics]\nlisten = "127.0.0.1:{self.port}"\n')
        self.write("right", timeout_s="0.6")
        self.agent: Agent | None = None

    def write(self, rig: str, timeout_s: str = "0.5", limit: str = "15.0", extra: str = "") -> None:
        extra += f"\n[agent]\nworkers = {self.workers}\n"
        text = self._text.replace('"two-mass-rig"', f'"{rig}"').replace('"two-mass-rig.db"', '"../all.db"')
        text = text.replace('transport = "tcp"', f'transport = "tcp"\ntimeout_s = {timeout_s}')
        assert "limit = 15.0" in text
        (self.folder / f"{rig}.toml").write_text(text.replace("limit = 15.0", f"limit = {limit}") + extra)

    def runs(self, rig: str) -> int:
        return int(rows(self.db, "SELECT count(*) FROM v_runs WHERE rig = ?", rig)[0][0])

    def rigs(self) -> list[str]:
        return [rig["rig"] for rig in status(self.db)["rigs"]]

    def flows(self, rig: str, run: int, least: int = 5) -> None:
        """Wait for rows of a rig's run, counted from 1."""
        query = (
            "SELECT count(DISTINCT t_ns) FROM v_estimates_windows WHERE run_id = "
            "(SELECT run_id FROM v_runs WHERE rig = ? ORDER BY run_id LIMIT 1 OFFSET ?)"
        )
        wait_until(lambda: rows(self.db, query, rig, run - 1)[0][0] >= least, f"rows of {rig}, run {run}")


class Manager:
    """A service manager's socket, and what has come to it."""

    def __init__(self, file: Path) -> None:
        self.said: list[str] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(file))
        self._thread = threading.Thread(target=self._work)
        self.environment = {"NOTIFY_SOCKET": str(file), "WATCHDOG_USEC": "60000000"}

    def __enter__(self) -> Self:
        self._thread.start()
        os.environ.update(self.environment)
        return self

    def __exit__(self, *_: object) -> None:
        for name in self.environment:
            del os.environ[name]
        self._socket.sendto(b"", self._socket.getsockname())
        self._thread.join()
        self._socket.close()

    def _work(self) -> None:
        while message := self._socket.recv(4096):
            self.said.append(message.decode())


@pytest.fixture(scope="module", params=[1, pytest.param(2, marks=pytest.mark.soak)])
def left(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a day of an administrator left behind, in seconds."""
    folder = tmp_path_factory.mktemp("gateway")
    text = example("modbus", folder).read_text()
    found: dict[str, Any] = {}
    with simulator(folder, text, "--scenario", "steady"):
        gateway = Gateway(folder, text, request.param)
        with Manager(folder / "notify") as manager, agent(gateway.folder) as running:
            found |= live_through(gateway, running, folder)
            found["document"] = running.document()
            found["log"] = running.err
    found["gateway"], found["said"] = gateway, manager.said
    return found


def live_through(gateway: Gateway, running: Agent, folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = {}
    wait_until(lambda: min(hops(gateway.db, "left"), hops(gateway.db, "right")) >= 5, "rows of both")
    gateway.write("right", "0.6", limit="14.0")
    found["changed"] = reload(gateway.db)
    gateway.flows("right", 2)
    gateway.write("third")  # the keys of its source are those of the left one: they share a connection
    found["added"] = reload(gateway.db)
    gateway.flows("third", 1)
    gateway.write("right", "0.6", limit='"much"', extra=f'\n[mqtt]\npassword = "{SECRET}"\n')
    with pytest.raises(ConfigError) as refusal:
        reload(gateway.db)
    found["refused"] = str(refusal.value)
    found["after refusal"] = status(gateway.db)
    with urllib.request.urlopen(f"http://127.0.0.1:{gateway.port}/metrics", timeout=5.0) as answer:
        found["metrics"] = answer.read().decode()
    found["peak_mb"] = peak_mb(running.process.pid)
    diag.diag(gateway.db, folder / "diag.tar.gz")
    gateway.write("right", "0.6", limit="14.0")
    (gateway.folder / "third.toml").unlink()
    running.process.send_signal(signal.SIGHUP)
    wait_until(lambda: gateway.rigs() == ["left", "right"], "the third to leave")
    return found


def peak_mb(pid: int) -> float:
    """Return the most memory that a process has had resident."""
    line = re.search(r"VmHWM:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())
    assert line is not None
    return int(line[1]) / 1024


def test_service_manager_hears_of_start_reloads_and_end(left: dict[str, Any]) -> None:
    states = [line for said in left["said"] for line in said.splitlines() if not line.startswith("STATUS")]
    steps = [line.partition("=")[0] for line in states if line != "WATCHDOG=1"]
    assert steps == ["READY", *["RELOADING", "MONOTONIC_USEC", "READY"] * 4, "STOPPING"]
    assert states.count("WATCHDOG=1") >= 3
    assert any(re.search(r"STATUS=3 rigs: left \d+\.\d s behind, right ", said) for said in left["said"])


def test_agent_of_three_rigs_keeps_within_its_memory(left: dict[str, Any]) -> None:
    assert left["peak_mb"] <= 110.0 + 2 * 12.0


def test_rig_whose_file_changed_starts_anew_and_only_that(left: dict[str, Any]) -> None:
    assert left["changed"] == {"restarted": ["right"], "added": [], "removed": [], "untouched": ["left"]}
    assert (left["gateway"].runs("left"), left["gateway"].runs("right")) == (1, 2)


def test_rigs_that_no_reload_touches_lose_no_sample(left: dict[str, Any]) -> None:
    (samples,) = (run["samples"] for run in left["document"]["runs"] if run["rig"] == "left")
    assert samples["received"] == samples["used"] > 1000
    assert (samples["rejected"], samples["dropped"], samples["gaps"]) == ({}, {}, 0)
    (windows,) = (run["windows"] for run in left["document"]["runs"] if run["rig"] == "left")
    assert windows == hops(left["gateway"].db, "left") == samples["used"] // 50


def test_rig_that_joins_a_connection_counts_from_its_own_beginning(left: dict[str, Any]) -> None:
    assert left["added"]["added"] == ["third"]
    assert left["added"]["untouched"] == ["left", "right"]
    query = "SELECT received, used, gaps FROM v_health WHERE rig = ? ORDER BY t_ns DESC LIMIT 1"
    ((received, used, gaps),) = rows(left["gateway"].db, query, "third")
    ((before, _, _),) = rows(left["gateway"].db, query, "left")
    assert 0 < received == used < before
    assert gaps == 0


def test_broken_file_is_refused_whole_and_an_event_says_what(left: dict[str, Any]) -> None:
    assert "alarm[0].limit" in left["refused"]
    assert [rig["rig"] for rig in left["after refusal"]["rigs"]] == ["left", "right", "third"]
    query = (
        "SELECT rig, message FROM v_events WHERE source = 'configuration' AND cause = 'refused' ORDER BY rig"
    )
    events = rows(left["gateway"].db, query)
    assert [rig for rig, _ in events] == ["left", "right", "third"]
    assert all("alarm[0].limit" in message for _, message in events)


def test_file_that_is_gone_takes_its_rig_along(left: dict[str, Any]) -> None:
    assert [run["rig"] for run in left["document"]["runs"]] == ["left", "right"]
    assert left["gateway"].runs("right") == 2  # its file was as before when the agent read it again


def test_status_tells_rigs_sources_threads_and_stores(left: dict[str, Any]) -> None:
    found = left["after refusal"]
    assert found["uptime_s"] > 1.0
    first = found["rigs"][0]
    assert [source["state"] for source in first["sources"]] == ["ok"]
    assert first["alarms"] == sum(first["alarm_states"].values())  # a busy machine may be behind
    assert 0.0 <= first["lag_s"] < 5.0
    assert {row["status"] for row in first["estimates"].values()} <= {
        "warming",
        "valid",
        "unexcited",
        "invalid",
    }
    threads = {re.sub(r"worker \d: ", "", thread["thread"]).split()[0] for thread in found["threads"]}
    assert {"processing", "read", "write", "events"} <= threads
    assert not any(thread["stalled"] for thread in found["threads"])
    assert found["stores"][0]["bytes"]["database"] > 0


def test_metrics_are_those_of_the_agent(left: dict[str, Any]) -> None:
    lines = dict(line.rsplit(" ", 1) for line in left["metrics"].splitlines() if not line.startswith("#"))
    assert lines['deltak_source_up{rig="third",source="modbus"}'] == "1.0"
    assert lines['deltak_thread_stalled{thread="processing"}'] == "0.0"
    assert float(lines['deltak_row_latency_seconds_count{rig="left"}']) >= 1
    states = [
        float(n)
        for line, n in lines.items()
        if line.startswith('deltak_estimate_state{parameter="k1",rig="left"')
    ]
    assert sorted(states) == [0.0, 0.0, 0.0, 1.0]


def test_status_without_an_agent_says_so(left: dict[str, Any]) -> None:
    with pytest.raises(StoreError, match="no agent runs on it"):
        status(left["gateway"].db)


def test_bundle_holds_what_support_needs_and_no_secret(left: dict[str, Any]) -> None:
    with tarfile.open(left["gateway"].db.with_name("diag.tar.gz")) as archive:
        parts = {name: archive.extractfile(name).read() for name in archive.getnames()}  # type: ignore[union-attr]
    assert [name for name, content in parts.items() if SECRET.encode() in content] == []
    assert b'password = "REMOVED"' in parts["deltak-diag/config/1-right.toml"]
    assert b"limit" in parts["deltak-diag/config/1-right.toml"]
    assert {"numpy", "pydantic"} <= set(json.loads(parts["deltak-diag/versions.json"])["packages"])
    assert json.loads(parts["deltak-diag/status.json"])["rigs"][0]["rig"] == "left"
    assert b"refused" in parts["deltak-diag/log.txt"]
    assert json.loads(parts["deltak-diag/database/runs.json"])
    assert any(row["name"] == "hops" for row in json.loads(parts["deltak-diag/database/schema.json"]))


@pytest.mark.soak
@pytest.mark.parametrize("workers", [1, 2])
def test_fifty_reloads_cost_the_other_rig_no_sample(workers: int, tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text()
    with simulator(tmp_path, text, "--scenario", "steady"):
        gateway = Gateway(tmp_path, text, workers)
        with agent(gateway.folder) as running:
            wait_until(lambda: min(hops(gateway.db, "left"), hops(gateway.db, "right")) >= 5, "rows of both")
            for number in range(50):
                gateway.write("right", "0.6", limit=f"{14 + number % 2}.5")
                assert reload(gateway.db)["restarted"] == ["right"]
            document = running.document()
    samples = {run["rig"]: run["samples"] for run in document["runs"]}
    assert samples["left"]["received"] == samples["left"]["used"] > 1000
    assert (samples["left"]["rejected"], samples["left"]["dropped"], samples["left"]["gaps"]) == ({}, {}, 0)
    assert (gateway.runs("left"), gateway.runs("right")) == (1, 51)
