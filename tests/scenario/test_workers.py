"""Rigs over worker processes: what ends one worker costs only its rigs, is counted, and is over by itself."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from agent.cli.gateway.status import reload, status
from agent.errors import ConfigError
from agent.storage.operations import command_alarms
from agent.storage.write.alarm_commands import Request
from tests.scenario.live import Agent, agent, example, hops, rows, wait_until
from tests.scenario.test_reload import Gateway
from tests.sim.rigs import simulator

pytestmark = pytest.mark.realtime
WATCHDOG_S = 5


def process_of(gateway: Gateway, rig: str) -> int:
    """Return the number of the process that runs a rig."""
    (found,) = (worker["pid"] for worker in status(gateway.db)["workers"] if rig in worker["rigs"])
    return int(found)


@contextmanager
def spread(folder: Path) -> Iterator[tuple[Gateway, Agent]]:
    """Run an agent of two rigs in two workers, both of which store rows."""
    text = example("modbus", folder).read_text()
    with simulator(folder, text, "--scenario", "steady"):
        gateway = Gateway(folder, text, workers=2)
        with agent(gateway.folder) as running:
            wait_until(lambda: min(hops(gateway.db, "left"), hops(gateway.db, "right")) >= 5, "rows of both")
            yield gateway, running


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What a killed worker and reloads left behind."""
    found: dict[str, Any] = {}
    with spread(tmp_path_factory.mktemp("workers")) as (gateway, running):
        found["gateway"], found["before"] = gateway, status(gateway.db)
        os.kill(process_of(gateway, "right"), signal.SIGKILL)
        gateway.flows("right", 2)
        gateway.write("right", "0.6", limit="14.0")
        found["changed"] = reload(gateway.db)
        gateway.flows("right", 3)
        gateway.write("right", "0.6", limit='"much"')
        with pytest.raises(ConfigError):
            reload(gateway.db)
        (alarm,) = rows(gateway.db, "SELECT id FROM v_alarms WHERE kind = 'source' AND parameter = 'worker'")
        command_alarms(gateway.db, Request("acknowledge", alarm, "shift"))
        wait_until(lambda: None not in lags(gateway), "word from a worker begun anew")
        found["after"] = status(gateway.db)
        found["document"] = running.document()
    return found


def lags(gateway: Gateway) -> list[float | None]:
    return [rig["lag_s"] for rig in status(gateway.db)["rigs"]]


def events(db: Path, rig: str, cause: str) -> list[str]:
    query = "SELECT message FROM v_events WHERE rig = ? AND source = 'worker' AND cause = ? ORDER BY t_ns"
    return [message for (message,) in rows(db, query, rig, cause)]


def test_rigs_run_in_processes_of_their_own_and_one_writes(left: dict[str, Any]) -> None:
    workers = left["before"]["workers"]
    assert [worker["rigs"] for worker in workers] == [["left"], ["right"]]
    assert len({worker["pid"] for worker in workers}) == 2
    threads = {thread["thread"].split(" /")[0].partition("/")[0] for thread in left["before"]["threads"]}
    assert {"processing", "write", "worker 1", "worker 1: processing", "worker 2: read right"} <= threads
    assert [rig["rig"] for rig in left["before"]["rigs"]] == ["left", "right"]
    assert all(-1.0 < rig["lag_s"] < 60.0 for rig in left["after"]["rigs"])


def test_what_ends_a_worker_costs_the_other_no_sample(left: dict[str, Any]) -> None:
    (run,) = (run for run in left["document"]["runs"] if run["rig"] == "left")
    samples = run["samples"]
    assert samples["received"] == samples["used"] > 1000
    assert (samples["rejected"], samples["dropped"], samples["gaps"]) == ({}, {}, 0)
    assert run["windows"] == hops(left["gateway"].db, "left") == samples["used"] // 50
    assert left["gateway"].runs("left") == 1


def test_worker_that_was_killed_begins_anew_and_what_was_lost_is_counted(left: dict[str, Any]) -> None:
    db = left["gateway"].db
    (ended,) = events(db, "right", "ended")
    assert "was ended by signal 9; the rig begins anew" in ended
    (lost,) = events(db, "right", "samples lost")
    assert int(lost.split(" samples")[0].split()[-1]) > 0
    assert events(db, "left", "ended") == events(db, "left", "samples lost") == []
    assert [worker["restarts"] for worker in left["after"]["workers"]] == [0, 1]
    assert left["gateway"].runs("right") == 3


def test_alarm_of_a_worker_that_was_gone_is_over_when_it_computes_again(left: dict[str, Any]) -> None:
    query = "SELECT rig, state, acked_by FROM v_alarms WHERE kind = 'source' AND parameter = 'worker'"
    assert rows(left["gateway"].db, query) == [("right", "NORM", "shift")]


def test_reload_of_one_rig_leaves_other_workers_alone(left: dict[str, Any]) -> None:
    assert left["changed"] == {"restarted": ["right"], "added": [], "removed": [], "untouched": ["left"]}
    query = "SELECT rig FROM v_events WHERE source = 'configuration' AND cause = 'refused' ORDER BY rig"
    assert rows(left["gateway"].db, query) == [("left",), ("right",)]


@pytest.mark.soak
def test_worker_that_hangs_is_named_and_started_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WATCHDOG_USEC", str(WATCHDOG_S * 1_000_000))
    with spread(tmp_path) as (gateway, running):
        os.kill(process_of(gateway, "right"), signal.SIGSTOP)
        gateway.flows("right", 2)
        assert [worker["restarts"] for worker in status(gateway.db)["workers"]] == [0, 1]
        document = running.document()
    assert "worker 2: the thread makes no progress since" in running.err
    (ended,) = events(gateway.db, "right", "ended")
    assert "made no progress" in ended
    (samples,) = (run["samples"] for run in document["runs"] if run["rig"] == "left")
    assert samples["received"] == samples["used"] > 1000
    assert (samples["rejected"], samples["dropped"], samples["gaps"]) == ({}, {}, 0)
