"""Hypotheses under windows that are straight only about the points at which they were linearised."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.inference import tuning
from agent.numerics.inference.information import Information, Update

SD = 1e-3
TRUTH = np.array([0.0, -0.09])
"""Two constants, of which every window tells one curve: what `curve` is at the truth."""
ALONE = (np.diag([0.09, 1e-8]), np.diag([1e-8, 0.09]))
"""Prior covariances of two hypotheses: the first constant is off, or the second."""


def curve(eta: np.ndarray) -> float:
    return float(eta[0] + 1.4 * eta[1] + 0.8 * eta[0] ** 2 - eta[1] ** 2)


def seen(at: np.ndarray, noise: float = 0.0) -> Information:
    """A window that reads the curve to `SD`, linearised at a point (2,)."""
    slope = np.array([1.0 + 1.6 * at[0], 1.4 - 2.0 * at[1]])
    left = curve(TRUTH) + noise - curve(at)
    size = np.linalg.norm(slope) ** 2 / SD**2
    return Information(
        np.outer(slope, slope) / SD**2, slope * left / SD**2, at, (left / SD) ** 2,
        1.3 * np.eye(2), np.full(2, size),
    )  # fmt: skip


def prior() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.array([0.5, 0.5]), np.zeros((2, 2)), np.array(ALONE)


def told(places: int, rng: np.random.Generator) -> np.ndarray:
    """Weights after thirty windows, each straight somewhere between both, and at so many further places."""
    known = prior()
    for _ in range(30):
        share = rng.uniform()
        point, noise = np.array([-0.15 * share, -0.09 * (1 - share)]), SD * float(rng.standard_normal())
        update = Update(*known, seen(point, noise))
        for _ in range(places):
            if (place := update.farthest()) is not None:
                update.also(seen(place, noise))
        known = update.weight, update.mean, update.covariance(np.arange(2))
    return known[0]


def test_what_no_window_tells_apart_stays_a_tie_though_each_is_straight_elsewhere() -> None:
    assert told(0, np.random.default_rng(5)).max() > 0.999  # one of both is refuted by the terms neglected
    assert told(tuning.PLACES, np.random.default_rng(5)).max() < 0.8


def test_hypotheses_are_updated_where_they_stand() -> None:
    update = Update(*prior(), seen(np.array([-0.05, -0.05])))
    linear = update.mean.copy()
    while (place := update.farthest()) is not None:
        update.also(seen(place))
    mean = update.mean
    assert update.nearest[0] != update.nearest[1]
    second = update.covariance(np.array([1]))
    np.testing.assert_allclose(second[0], update.covariance(np.arange(2))[1], rtol=1e-12)
    assert mean[1] == pytest.approx(TRUTH, abs=1e-4)
    assert curve(mean[0]) == pytest.approx(curve(TRUTH), abs=1e-4)
    assert abs(curve(linear[0]) - curve(TRUTH)) > 3 * SD


def test_update_by_a_window_that_is_straight_enough_asks_for_no_other_point() -> None:
    update = Update(*prior(), seen(TRUTH))
    near = Update(np.ones(1), np.array([TRUTH + 1e-3]), np.eye(2)[None] * 1e-6, seen(TRUTH))
    assert update.farthest() is not None
    assert near.farthest() is None


def test_hypothesis_whose_mean_leaves_the_points_made_for_it_asks_no_third_time() -> None:
    """Places that say the opposite each time: it runs from one to the next, and stays refuted."""
    update = Update(*prior(), seen(np.array([-0.05, -0.05])))
    asked = 0
    while (place := update.farthest()) is not None:
        asked += 1
        turned = seen(place)
        update.also(replace(turned, g=turned.S @ np.array([0.3, -0.3]) - turned.g, cost=1e6))
    assert asked <= 4


def test_point_that_was_made_for_a_hypothesis_takes_it_though_its_mean_moves_on() -> None:
    """What was said about the first point reached too short: the second has it farther than it was."""
    S, tells = 1e4 * np.eye(1), np.full(1, 1e4)
    first = Information(S, S @ np.array([0.2]), np.zeros(1), 0.0, np.eye(1), tells)
    update = Update(np.ones(1), np.zeros((1, 1)), np.ones((1, 1, 1)), first)
    place = update.farthest()
    assert place is not None
    update.also(Information(S, S @ np.array([0.3]), place, 0.0, np.eye(1), tells))
    assert update.nearest.tolist() == [1]
    assert update.mean[0] == pytest.approx([0.5], rel=1e-3)


def test_unlikely_hypotheses_cost_no_further_point() -> None:
    weight, mean, covariance = prior()
    update = Update(np.array([1.0, 1e-12]), mean, covariance, seen(np.array([-0.145, 0.0])))
    places = []
    while (place := update.farthest()) is not None:
        places.append(place)
        update.also(seen(place))
    assert all(place[1] == pytest.approx(0.0, abs=1e-6) for place in places)
    assert weight.sum() == pytest.approx(1.0)
