"""Faults and movements that end, on simulated time: nothing of them judges what comes after, and no sensor is
blamed for what the structure did."""

from pathlib import Path
from typing import Any

import pytest

from agent.evaluation.score.score import score
from tests.scenario.test_score import changed, quiet

UNTIL_S, WINDOW_S, HOP_S = 2.6, 0.25, 0.05


def scored(path: Path) -> dict[str, Any]:
    (document,) = score([str(path)], [], quiet)["scenarios"]
    return dict(document)


def test_estimates_are_valid_again_a_window_after_a_faulty_sensor_is_sound(tmp_path: Path) -> None:
    path = changed("stuck-sensor", tmp_path, stuck="gain = -2.0", from_s="from_s = 1.5",
                   until_s=f"until_s = {UNTIL_S}", duration_s="duration_s = 4.0",
                   sensors="valid_percent = 50")  # fmt: skip
    found = scored(path)
    # from the first whole window on all rows but those that hold the fault are valid
    rows, spoilt = (4.0 - WINDOW_S) / HOP_S, (UNTIL_S - 1.5 + WINDOW_S) / HOP_S
    assert found["valid_percent"] >= 100.0 * (1.0 - (spoilt + 2) / rows)


@pytest.mark.parametrize(("percent", "seed"), [(30, 11), (-30, 13)])
def test_a_spring_that_changes_by_a_third_within_seconds_is_blamed_on_no_sensor(
    percent: int, seed: int, tmp_path: Path
) -> None:
    path = changed("ramp", tmp_path, percent=f"percent = {{ k2 = {percent}.0 }}", seed=f"seed = {seed}",
                   ramp_s="ramp_s = 4.0", duration_s="duration_s = 5.0",
                   rms_percent="rms_percent = 50.0")  # fmt: skip
    found = scored(path)
    assert found["sensors"] == []
    assert [excursion["delay_s"] is None for excursion in found["alarms"]["excursions"]] == [False]
