"""The service under real systemd, in a User-Mode Linux guest: it starts, tells, reloads, hangs, and ends."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from tests import figures, peers
from tests.vcan import guest

LIMIT_S = 300.0
TRIES = 3
"""Of booting a guest: its kernel dies now and then under systemd (it cannot read a register of process 1 any
more)."""
pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(TRIES * LIMIT_S)]


def lived(
    folder: Path,
    *settings: str,
    script: str = "tests.systemd.inside",
    disk: Path | None = None,
    until: str | None = None,
    limit_s: float = LIMIT_S,
) -> dict[str, Any]:
    """Boot a guest and return what was found in it; until: a file it leaves before it is switched off."""
    if not Path("/lib/systemd/systemd").exists():
        peers.missing("systemd is not installed (Debian package systemd)")
    command = ["env", *settings, sys.executable, "-m", script]
    init = Path(__file__).with_name("init.sh")
    for _ in range(TRIES):
        status, output = guest.run(command, peers.ROOT, limit_s, folder, init=init, disk=disk)
        if until is not None and (folder / until).exists():
            return {}
        if status != guest.DIED:
            break
    assert status == 0, output
    return dict(json.loads((folder / "found.json").read_text()))


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return lived(tmp_path_factory.mktemp("left"))


def test_start_waits_until_the_rigs_are_set_up_and_databases_are_open(found: dict[str, Any]) -> None:
    assert found["socket at ready"]
    assert found["state"] == ["active", "0", "deltak", "notify"]


def test_reload_that_is_asked_for_while_it_starts_ends_nothing(found: dict[str, Any]) -> None:
    assert found["survives an early reload"] == [True, "0"]


def test_no_core_file_is_written_and_hundreds_of_rigs_have_their_threads(found: dict[str, Any]) -> None:
    assert found["limits"] == ["0", "0", "4096"]


def test_can_serial_and_tcp_deliver_rows_inside_the_sandbox(found: dict[str, Any]) -> None:
    assert found["flows"] == ["can", "line", "plc"]
    assert found["status"].startswith("3 rigs: can ")


def test_who_may_read_the_database_may_not_therefore_command(found: dict[str, Any]) -> None:
    assert found["reader"] == {"read": True, "write": False, "command": False}
    assert found["commander"] == {"read": True, "write": False, "command": True}


def test_page_reads_signs_in_and_reaches_the_agent_inside_its_sandbox(found: dict[str, Any]) -> None:
    page = {"rigs": ["can", "line", "plc"], "signed in": 200, "refused": [409, True], "user": "deltak-page"}
    assert found["page"] == page


def test_opcua_server_answers_inside_its_sandbox(found: dict[str, Any]) -> None:
    assert found["opcua"]


def test_reload_starts_only_the_rig_anew_whose_file_changed(found: dict[str, Any]) -> None:
    assert found["runs"] == [["can", 1], ["line", 1], ["plc", 2]]


def test_hung_thread_is_named_and_its_agent_ended_to_be_started_anew(found: dict[str, Any]) -> None:
    assert "read line/hanging: the thread makes no progress" in found["log"]
    assert found["killed_s"] <= 3 * found["watchdog_s"]
    assert found["after hang"] == "auto-restart"
    figures.figure(f"a hung reader: ended after {found['killed_s']:.1f} s, WatchdogSec={found['watchdog_s']}")


def test_stop_ends_what_waits_to_be_started_too(found: dict[str, Any]) -> None:
    assert found["stop_s"] <= 3.0
    assert found["after stop"] == "inactive"


@pytest.mark.soak
def test_agent_that_the_watchdog_ended_goes_on_and_stops_within_three_seconds(tmp_path: Path) -> None:
    found = lived(tmp_path, "DELTAK_WHOLE=1")
    assert found["restarts"] == "1"
    assert found["stop_s"] <= 3.0
    assert found["after stop"] == "inactive"
