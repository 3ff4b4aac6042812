"""Errors and stated deviations of many runs against the Cramer-Rao bound, the parameters up to 20 % off
nominal."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from agent.types import FloatArray
from tests.statistical.chains import TWO
from tests.statistical.machine import each, say
from tests.statistical.right_models import Errors, compared

QUICK, FULL = 24, 500
WIDEBAND = replace(TWO, force_n=5.0, force_hz=100.0)


def one_run(seed: int, windows: int) -> Errors:
    """The rig under a force of wide bandwidth, each parameter up to 20 % off what is configured."""
    rng = np.random.default_rng([seed, 7])
    theta: FloatArray = TWO.theta * rng.uniform(0.8, 1.2, 4)
    true = replace(WIDEBAND, springs=tuple(theta[:2].tolist()), dampers=tuple(theta[2:].tolist()))
    return compared(true, WIDEBAND, rng, windows)


def hold(
    found: list[Errors],
    efficiency: tuple[float, float],
    coverage: tuple[float, float],
    request: pytest.FixtureRequest,
) -> None:
    error, sd, valid, held = (
        np.concatenate([getattr(e, part) for e in found]) for part in ("error", "sd", "valid", "held")
    )
    rmse = np.sqrt(np.mean(error**2, axis=0))
    # the median: a first window, of whose noise little is known, states more
    stated = np.median(sd, axis=0)
    covered = held.mean(axis=0)
    text = f"{len(found)} runs: RMSE / bound {rmse.round(3)}, median sd / bound {stated.round(3)}"
    say(request, f"{text}, coverage {covered.round(3)}")
    assert np.all((rmse >= efficiency[0]) & (rmse <= efficiency[1]))
    assert np.all((stated >= 0.9) & (stated <= 1.2))
    assert np.all((covered >= coverage[0]) & (covered <= coverage[1]))
    assert valid.mean() >= 0.99


def test_runs_off_nominal_reach_the_bound_and_say_so(request: pytest.FixtureRequest) -> None:
    hold([one_run(seed, 4) for seed in range(QUICK)], (0.8, 1.2), (0.88, 1.0), request)


@pytest.mark.soak
def test_pooled_over_thousands_of_intervals_reaches_the_bound(request: pytest.FixtureRequest) -> None:
    hold(each(partial(one_run, windows=6), range(1000, 1000 + FULL)), (0.95, 1.05), (0.935, 0.97), request)
