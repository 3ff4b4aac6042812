"""Intervals of every window of a list hold the truth as often as they say, from the first whole window on."""

import numpy as np
import pytest

from tests.statistical.machine import say
from tests.statistical.window_lists import LISTS, shares

QUICK, FULL = 20, 200


def measured(name: str, runs: int, request: pytest.FixtureRequest, least: float) -> None:
    seconds = 2.4 * LISTS[name][-1] / 1000
    valid, covered = shares(name, runs, seconds)
    texts = [f"{part.min():.2f} .. {part.max():.2f}" for part in covered]
    windows = ", ".join(f"{w} {t}" for w, t in zip([*LISTS[name], "chosen"], texts, strict=True))
    say(request, f"windows {name}, {runs} runs of {seconds:g} s: covered by {windows}")
    # no window is right by never being asked
    assert valid[1:].min() > 0.5
    assert np.nanmin(covered) >= least


@pytest.mark.parametrize("name", ["a quarter and 5 s", "auto of a faster rig"])
def test_intervals_of_every_window_of_a_list_hold_the_truth(name: str, request: pytest.FixtureRequest) -> None:
    measured(name, QUICK, request, least=0.85)


@pytest.mark.soak
@pytest.mark.parametrize("name", LISTS)
def test_intervals_of_every_window_of_a_list_hold_the_truth_in_200_runs(
    name: str, request: pytest.FixtureRequest
) -> None:
    measured(name, FULL, request, least=0.9)
