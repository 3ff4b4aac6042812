"""Intervals of windows with holes hold the truth as often as they say (200 runs under soak)."""

import numpy as np
import pytest

from tests.statistical.gaps import HOLES, one
from tests.statistical.machine import NAMES, each, say

QUICK, FULL = 6, 200


def measured(name: str, runs: range, request: pytest.FixtureRequest) -> None:
    valid, covered = (
        np.mean(part, axis=0) for part in zip(*each(one, [(name, seed) for seed in runs]), strict=True)
    )
    cells = zip(NAMES, valid, covered, strict=True)
    text = ", ".join(f"{n} {100 * c:.1f} % ({100 * v:.1f} % valid)" for n, v, c in cells)
    say(request, f"{name}, {len(runs)} runs of 6 windows: {text}")
    assert valid.min() >= 0.99
    assert covered.min() >= 0.90


EVERY_RUN = ("1 % lost samples",)  # the others go to soak, where all of them run in full


@pytest.mark.parametrize("name", EVERY_RUN)
def test_intervals_of_windows_with_holes_hold_the_truth(name: str, request: pytest.FixtureRequest) -> None:
    measured(name, range(QUICK), request)


@pytest.mark.soak
@pytest.mark.parametrize("name", HOLES)
def test_intervals_of_windows_with_holes_hold_the_truth_in_200_runs(
    name: str, request: pytest.FixtureRequest
) -> None:
    measured(name, range(10_000, 10_000 + FULL), request)
