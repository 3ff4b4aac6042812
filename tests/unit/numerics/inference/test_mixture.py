"""Intervals of Gaussian mixtures."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import norm

from agent.numerics.inference.mixture import interval95


def test_mixture_of_one_is_its_own_interval() -> None:
    lower, upper = interval95(np.array([1.0]), np.array([[3.0]]), np.array([[2.0]]))
    assert (lower[0], upper[0]) == pytest.approx(tuple(norm.interval(0.95, 3.0, 2.0)))


def test_mixture_with_a_rare_wide_part_has_its_quantiles() -> None:
    weight, mean, sd = np.array([0.97, 0.03]), np.array([[0.0], [1.0]]), np.array([[1.0], [20.0]])
    lower, upper = interval95(weight, mean, sd)

    def share(x: float) -> float:
        return float(weight @ norm.cdf(x, mean[:, 0], sd[:, 0]))

    assert lower[0] == pytest.approx(brentq(lambda x: share(x) - 0.025, -100, 0), abs=1e-4)
    assert upper[0] == pytest.approx(brentq(lambda x: share(x) - 0.975, 0, 100), abs=1e-4)


def test_mixture_holds_the_interval_of_every_part_that_stands() -> None:
    weight, mean, sd = np.array([0.8, 0.2]), np.array([[0.0], [10.0]]), np.array([[1.0], [1.0]])
    lower, upper = interval95(weight, mean, sd)
    assert lower[0] <= -1.95
    assert upper[0] >= 11.95


def test_part_stands_by_its_share_of_the_likeliest_however_many_others_there_are() -> None:
    weight = np.array([0.3, 0.08, *[0.062] * 10])
    mean = np.array([0.0, 10.0, *np.zeros(10)])[:, None]
    sd = np.ones_like(mean)
    _, upper = interval95(weight, mean, sd)
    assert upper[0] == pytest.approx(10 + 1.96, abs=0.01)
    unlikely = np.array([0.9, 0.08, *[0.002] * 10])
    assert interval95(unlikely, mean, sd)[1][0] < 11.5
