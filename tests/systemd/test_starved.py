"""The service as it is shipped: ten minutes of hunger, a thread that hangs, and a journal that is rotated."""

from typing import Any

import pytest

from tests import figures
from tests.systemd.test_systemd import TRIES, lived

LIMIT_S = 1500.0
pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(TRIES * LIMIT_S)]


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return lived(tmp_path_factory.mktemp("left"), script="tests.systemd.inside_starved", limit_s=LIMIT_S)


def test_healthy_agent_that_starves_for_ten_minutes_is_left_to_run(found: dict[str, Any]) -> None:
    assert found["watchdog_s"] == 60
    assert found["starved_s"] >= 600.0
    assert found["share"] <= 0.035
    assert found["restarts of the starved"] == "0"
    figures.figure(
        f"an agent left {100 * found['share']:.1f} % of a processor for {found['starved_s']:.0f} s at "
        f"WatchdogSec={found['watchdog_s']}: not restarted"
    )


def test_hung_thread_is_named_and_its_agent_ended_within_three_intervals(found: dict[str, Any]) -> None:
    assert found["named"]
    assert found["killed_s"] <= 3 * found["watchdog_s"]
    figures.figure(f"a hung reader: ended after {found['killed_s']:.0f} s, WatchdogSec={found['watchdog_s']}")


def test_journal_that_is_rotated_killed_and_vacuumed_lacks_nothing_and_nobody_holds_what_is_deleted(
    found: dict[str, Any],
) -> None:
    assert set(found["unsaid"].values()) == {0}
    assert found["journals"] > found["journals after"]
    assert found["kept open"] == []
    figures.figure(f"a journal rotated, killed, vacuumed: {found['lines']} lines of rows stored, none lost")
