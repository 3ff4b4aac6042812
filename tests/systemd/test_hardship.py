"""The service under real systemd where a machine gives it too little: processor, memory, and at last
current."""

import json
import subprocess
from typing import Any

import pytest

from tests import figures, peers
from tests.systemd.test_systemd import TRIES, lived

LIMIT_S = 600.0
pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(2 * TRIES * LIMIT_S)]
DISK_BYTES = 64 << 20


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What two boots found, a power cut between them."""
    folder = tmp_path_factory.mktemp("left")
    disk = folder / "disk"
    with disk.open("wb") as file:
        file.truncate(DISK_BYTES)
    subprocess.run([peers.program("mkfs.ext4", "e2fsprogs"), "-q", disk], check=True)
    ask: dict[str, Any] = {"script": "tests.systemd.inside_hardship", "disk": disk, "limit_s": LIMIT_S}
    lived(folder, "DELTAK_WHOLE=1", until="first.json", **ask)
    first = json.loads((folder / "first.json").read_text())
    return first | lived(folder, "DELTAK_WHOLE=1", **ask)


def test_healthy_agent_that_starves_for_six_intervals_of_the_watchdog_is_left_to_run(
    found: dict[str, Any],
) -> None:
    assert found["share"] < 0.1
    assert found["restarts of the starved"] == "0"
    figures.figure(
        f"an agent left {100 * found['share']:.0f} % of a processor for six intervals of the watchdog: "
        "not restarted"
    )


def test_agent_that_meets_its_limit_of_memory_is_started_anew_and_has_lost_no_row(
    found: dict[str, Any],
) -> None:
    assert found["lost by memory"] == 0
    assert found["rows before memory"] > 100
    figures.figure(
        f"ended for lack of memory: {found['rows before memory']} rows acknowledged, none lost, "
        f"rows again after {found['back after s']:.0f} s"
    )


def test_power_cut_takes_no_row_that_was_acknowledged_and_the_boot_goes_on(found: dict[str, Any]) -> None:
    assert found["lost by cut"] == 0
    assert found["rows before cut"] > found["rows before memory"]
    assert found["integrity"] == "ok"
    assert dict(found["runs"]) == {"can": 3, "line": 3, "plc": 3}
    figures.figure(f"power cut of the guest: {found['rows before cut']} rows acknowledged, none lost")
