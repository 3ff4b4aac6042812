"""Suspect readings of inputs: what the motion says of them together."""

import numpy as np
import pytest

from agent.numerics.estimator.doubts import Doubts, Found

SIZES = (-34.5, -36.3)


def suspected() -> Doubts:
    doubts = Doubts()
    u = np.zeros((10, 1))
    u[4:6, 0] = SIZES
    suspect = np.zeros((10, 3), dtype=bool)
    suspect[4:6, 2] = True
    assert not doubts.replaced(100, u, suspect, 2).any()
    return doubts


def found(likely: tuple[float, float]) -> Found:
    """Posterior of two readings whose sum the motion tells to 0.5, and whose difference to 40."""
    sum_and_difference = np.array([[1.0, 1.0], [1.0, -1.0]])
    information = sum_and_difference.T @ np.diag([0.5**-2, 40.0**-2]) @ sum_and_difference
    prior = np.abs(SIZES)
    covariance = np.linalg.inv(information + np.diag(prior**-2.0))
    return Found(((104, 2), (105, 2)), covariance @ information @ np.array(likely), covariance, prior)


@pytest.mark.parametrize("likely", [(-34.5, -36.3), (-14.0, -56.8), (-60.0, -10.8)])
def test_a_blow_of_two_readings_is_confirmed_by_their_sum(likely: tuple[float, float]) -> None:
    doubts = suspected()
    assert doubts.first_due(1000) == 104 + 250
    due = doubts.due(354, 1000)
    assert due == {(104, 2), (105, 2)}  # the second belongs to the first
    refused, confirmed = doubts.decide(due, found(likely))
    assert not refused
    assert confirmed == {(104, 2): SIZES[0], (105, 2): SIZES[1]}
    assert doubts.first_due(1000) is None


@pytest.mark.parametrize(("share", "is_confirmed"), [(0.9, True), (1.2, True), (0.6, False), (1.4, False)])
def test_a_blow_that_is_not_straight_between_its_readings_is_confirmed_all_the_same(
    share: float, is_confirmed: bool
) -> None:
    """A half sine of a few samples: the motion tells its impulse to a per cent."""
    doubts = suspected()
    said = found((share * SIZES[0], share * SIZES[1]))
    assert abs(share - 1) > 4 * said.share({(104, 2): SIZES[0], (105, 2): SIZES[1]})[1]
    refused, confirmed = doubts.decide(doubts.due(354, 1000), said)
    assert (refused == 0) == bool(confirmed) == is_confirmed


def test_a_spike_of_two_readings_is_refused_once() -> None:
    doubts = suspected()
    assert doubts.decide(doubts.due(354, 1000), found((20.0, -20.0))) == (2, {})
    assert doubts.decide(doubts.due(404, 1000), found((20.0, -20.0))) == (0, {})


def test_what_no_window_holds_any_more_is_let_be() -> None:
    doubts = suspected()
    doubts.lapse(105)
    assert doubts.first_due(1000) is None
