"""The service under a real systemd, in a User-Mode Linux guest: it starts, tells, reloads, hangs, and ends."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import figures, peers
from tests.vcan import guest

LIMIT_S = 300.0
pytestmark = [pytest.mark.realtime, pytest.mark.timeout(LIMIT_S + 20.0)]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if not Path("/lib/systemd/systemd").exists():
        peers.missing("systemd is not installed (Debian package systemd)")
    folder = tmp_path_factory.mktemp("left")
    command = [sys.executable, "-m", "tests.systemd.inside"]
    init = Path(__file__).with_name("init.sh")
    status, output = guest.run(command, peers.ROOT, LIMIT_S, folder, init=init)
    assert status == 0, output
    return dict(json.loads((folder / "found.json").read_text()))


def test_start_waits_until_the_rigs_are_set_up_and_databases_are_open(found: dict[str, Any]) -> None:
    assert found["socket at ready"]
    assert found["state"] == ["active", "0", "deltak", "notify"]


def test_can_serial_and_tcp_deliver_rows_inside_the_sandbox(found: dict[str, Any]) -> None:
    assert found["flows"] == ["can", "line", "plc"]
    assert found["status"].startswith("3 rigs: can ")


def test_who_may_read_the_database_may_not_therefore_command(found: dict[str, Any]) -> None:
    assert found["reader"] == {"read": True, "write": False, "command": False}
    assert found["commander"] == {"read": True, "write": False, "command": True}


def test_reload_starts_only_the_rig_anew_whose_file_changed(found: dict[str, Any]) -> None:
    assert found["runs"] == [["can", 1], ["line", 1], ["plc", 2]]


def test_hung_thread_is_named_and_the_agent_restarted(found: dict[str, Any]) -> None:
    assert "read line/hanging: the thread makes no progress" in found["log"]
    assert found["anew"]
    assert found["killed_s"] <= 3 * found["watchdog_s"]
    figures.figure(f"a hung reader: restarted after {found['killed_s']:.1f} s, WatchdogSec={found['watchdog_s']}")


def test_stop_amid_a_start_takes_three_seconds_at_most(found: dict[str, Any]) -> None:
    assert found["stop_s"] <= 3.0
    assert found["after stop"] == ["inactive", "success"]
