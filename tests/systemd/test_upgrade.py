"""A version whose agent is ready but gives no valid rows is taken back by its unit, under a real systemd in a
guest."""

from pathlib import Path

import pytest

from tests import figures
from tests.systemd.test_systemd import LIMIT_S, TRIES, lived

pytestmark = [pytest.mark.realtime, pytest.mark.soak, pytest.mark.timeout(TRIES * LIMIT_S)]


def test_version_without_valid_rows_is_taken_back_by_its_unit_and_the_former_one_runs(tmp_path: Path) -> None:
    found = lived(tmp_path, script="tests.systemd.inside_upgrade")
    assert found["said"] == (
        "deltak: error: upgrade to 2.0.0: taken back: no valid row of press-7 within 30 s; "
        "1.0.0 runs again and gives valid rows\n"
    )
    assert found["unit"] == ["exit-code", "1"]
    assert (found["current"], found["state"]) == ("1.0.0", "active")
    assert found["runs"] == [[3], [2]]
    figures.figure(
        f"a version without valid rows: the former one runs again after {found['seconds']:.0f} s, "
        "30 of them waited"
    )
