"""Configurations that are nearly right: estimates stay valid, intervals hold, and what is off is named or
nobody is."""

from functools import partial

import pytest

from tests.statistical.machine import each, say
from tests.statistical.nearly_right import CASES, Case, Found, play, together

QUICK_WINDOWS, FULL_WINDOWS, FULL_RECORDINGS = 30, 100, 3
FIRST_SEED = 5000
QUICK = (
    "right", "noise x 0.5", "m1 +5 %", "middle mass +8 %",
    "x2 reads 5 % more, three masses",
    "held, hold first, one mass", "hum", "driving-point accelerometer", "mass 3 % and hum",
    "force noise and x2 +4 %", "late and m1 +3 %, hold zero, accelerometers",
)  # fmt: skip
SLACK_SD = 3.0
"""Standard deviations of a count by which a share may lie below its bound."""


def least(share: float, count: float) -> float:
    """The share that `count` intervals may show when `share` of all hold; neighbours share noise and
    constants."""
    return share - SLACK_SD * float((share * (1 - share) / max(count, 1.0)) ** 0.5)


def hold(name: str, case: Case, found: Found, sure: float) -> None:
    """Assert what must be so; sure: share of the recordings in which what is right has to be said."""
    total, each_one = found.valid.sum(), found.valid.sum(axis=0).min()
    assert found.understood >= 0.97, f"{name}: {100 * found.understood:.1f} % of rows"
    assert found.cover >= least(0.93, total)
    assert found.worst >= least(0.90, each_one)
    assert not set(found.alarms) - case.right, f"{name}: alarms {found.alarms}"
    assert not found.wrong(case.right), f"{name}: {found.wrong(case.right)}"
    if case.said:
        assert sum(found.last.get(which, 0.0) for which in case.right) >= sure


@pytest.mark.parametrize("name", QUICK)
def test_nearly_right_configuration_gives_valid_rows_that_hold(
    name: str, request: pytest.FixtureRequest
) -> None:
    found = play(name, 1, QUICK_WINDOWS)
    say(request, f"{name}, {QUICK_WINDOWS} windows: {found}")
    hold(name, CASES[name], found, 0.5)


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
