"""Lists of windows: each estimate is of the shortest window that is sharp enough, and its interval holds the
truth."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.blocks.statistical_rig import estimator_settings
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.types import Status
from tests.statistical.chains import TWO, Chain
from tests.statistical.machine import each, say
from tests.statistical.nearly_right import SETTLE_WINDOWS, Play

LISTS = {"a quarter and 5 s": (250, 5000), "half, 2 and 8 s": (500, 2000, 8000)}
QUICK, FULL = 2, 20
SECONDS = 40


def shares(name: str, seed: int) -> tuple[int, int, int, int]:
    """Estimates of a run, those valid, those whose interval holds, and those that a longer window gave."""
    windows = LISTS[name]
    chain: Chain = replace(TWO, window_s=windows[0] / TWO.rate_hz)
    play = Play.of(
        chain, np.random.default_rng([seed, 78]), SETTLE_WINDOWS * TWO.window + SECONDS * TWO.window + 1
    )
    v = play.readings()[SETTLE_WINDOWS * TWO.window : -1]
    settings = estimator_settings(chain.configuration(hop_s=0.05), np.zeros(2))
    rows = SlidingEstimator(replace(settings, longer=windows[1:])).step(0, v[:, 1:], v[:, :1])
    late = rows.index >= windows[-1]
    valid = rows.status[late] == Status.VALID
    held = valid & (rows.lower[late] <= chain.theta) & (chain.theta <= rows.upper[late])
    longer = valid & (rows.window[late] > windows[0])
    return valid.size, int(valid.sum()), int(held.sum()), int(longer.sum())


def hold(
    name: str, found: list[tuple[int, int, int, int]], least: float, request: pytest.FixtureRequest
) -> None:
    total, valid, held, longer = np.sum(found, axis=0)
    text = f"{name}: {100 * valid / total:.1f} % valid, {100 * held / valid:.1f} % hold"
    say(request, f"{text}, {100 * longer / total:.1f} % of longer windows")
    assert held >= least * valid


@pytest.mark.parametrize("name", LISTS)
def test_estimates_of_a_list_of_windows_hold(name: str, request: pytest.FixtureRequest) -> None:
    hold(name, [shares(name, seed) for seed in range(QUICK)], 0.85, request)


@pytest.mark.soak
@pytest.mark.parametrize("name", LISTS)
def test_estimates_of_a_list_of_windows_hold_in_20_runs(name: str, request: pytest.FixtureRequest) -> None:
    hold(name, each(partial(shares, name), range(1000, 1000 + FULL)), 0.90, request)
