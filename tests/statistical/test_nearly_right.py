"""Configurations that are nearly right: estimates stay valid, intervals hold, and what is off is named or
nobody is."""

from functools import partial

import numpy as np
import pytest

from tests.statistical.machine import each, say
from tests.statistical.nearly_right import CASES, Case, Found, gains, hold, masses, play, played, together

QUICK_WINDOWS, FULL_WINDOWS, FULL_RECORDINGS = 30, 100, 3
FIRST_SEED = 5000
QUICK = (
    "right", "noise x 0.5", "m1 +5 %", "middle mass +8 %",
    "x2 reads 5 % more, three masses",
    "held, hold first, one mass", "hum", "driving-point accelerometer", "mass 3 % and hum",
    "force noise and x2 +4 %", "late and m1 +3 %, hold zero, accelerometers", "three digits",
    "a1 half a sample late, accelerometers",
)  # fmt: skip


@pytest.mark.parametrize("name", QUICK)
def test_nearly_right_configuration_gives_valid_rows_that_hold(
    name: str, request: pytest.FixtureRequest
) -> None:
    found = play(name, 1, QUICK_WINDOWS)
    say(request, f"{name}, {QUICK_WINDOWS} windows: {found}")
    hold(name, CASES[name], found, 0.5)


@pytest.mark.soak
def test_window_whose_noise_is_looked_for_anew_gives_no_verdict() -> None:
    """Of a window alone a delay was believed (0.92) that the next ones refute."""
    assert play("drift under an unknown force", 5001, FULL_WINDOWS).largest.get("delay", 0.0) < 0.5


def test_two_scales_that_nothing_tells_apart_leave_no_row_sure() -> None:
    """A mass 20 % and both outputs 10 % off move as two masses 11 % off do, one of them the other way."""
    case = Case(changes=(masses(1.0, 0.8), gains(0.9, 0.9)))
    found = played(case, np.random.default_rng(501), 12)
    assert found.understood >= 0.97
    assert found.held.sum() >= 0.95 * found.valid.sum()


@pytest.mark.soak
@pytest.mark.parametrize("name", CASES)
def test_nearly_right_configuration_holds_in_three_recordings(
    name: str, request: pytest.FixtureRequest
) -> None:
    seeds = range(FIRST_SEED, FIRST_SEED + FULL_RECORDINGS)
    found = together(each(partial(_one, name), seeds))
    say(request, f"{name}, {FULL_RECORDINGS} x {FULL_WINDOWS} windows: {found}")
    hold(name, CASES[name], found, 0.5)


def _one(name: str, seed: int) -> Found:
    return play(name, seed, FULL_WINDOWS)
