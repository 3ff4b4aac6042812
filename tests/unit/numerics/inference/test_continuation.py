"""A first window of a rig whose modes are elsewhere: parameters and constants move together."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.inference.spectral.columns import Window, window_of
from tests.unit.numerics.inference.chain import ChainRig
from tests.unit.numerics.inference.frequency import learner_of

RIG = ChainRig(
    masses=(5.0, 3.0, 4.0), springs=(250.0, 400.0, 300.0), dampers=(0.3, 0.2, 0.2), seen=("displacement",) * 3
)
SAMPLES = 2000
LEARNER = learner_of(RIG, SAMPLES)
SIGMA = np.full(3, 1e-5)


def window_with(eta: np.ndarray, stiffer: float) -> Window:
    """A window of the rig with constants off by logarithms eta (8,), all parameters times a factor."""
    rng = np.random.default_rng(8)
    u = 5.0 * rng.standard_normal((SAMPLES + 1, 1))
    y = RIG.readings(stiffer * RIG.theta, eta, np.zeros(6), u[1:], np.diff(u, axis=0)).real
    return window_of(y + SIGMA * rng.standard_normal(y.shape), u[1:], u[0])


@pytest.mark.parametrize(
    ("masses", "gain", "stiffer"),
    [(0.22, 0.0, 1.0), (-0.18, 0.0, 1.0), (-0.2, 0.03, 1.0), (0.0, 0.0, 1.3), (0.0, 0.0, 0.75)],
    ids=["masses +25 %", "masses -16 %", "masses -18 % and a gain +3 %", "springs +30 %", "springs -25 %"],
)
def test_first_window_of_a_rig_whose_modes_are_elsewhere_is_learnt_from(
    masses: float, gain: float, stiffer: float
) -> None:
    window = window_with(np.array([masses, masses, masses, 0.0, gain, 0.0, 0.0, 0.0]), stiffer)
    known = LEARNER.prior(SIGMA, np.full(3, 0.3))
    posterior, learnt = LEARNER.learn(window, known)
    assert posterior.converged
    # what masses, gains and the force share, no data tell: all parameters are off by one factor
    factor = posterior.theta / (stiffer * RIG.theta)
    assert np.all(np.abs(factor / factor.mean() - 1) < [0.01, 0.01, 0.01, 0.1, 0.1, 0.1])
    assert np.all((posterior.lower < stiffer * RIG.theta) & (stiffer * RIG.theta < posterior.upper))
    assert np.abs(learnt.noise.log_sigma - np.log(SIGMA)).max() < 0.5


def test_parameters_alone_do_not_come_to_rest_where_all_modes_are_elsewhere() -> None:
    window = window_with(np.array([0.22, 0.22, 0.22, 0.0, 0.0, 0.0, 0.0, 0.0]), 1.0)
    known = LEARNER.prior(SIGMA, np.full(3, 0.3))
    lineariser = LEARNER.lineariser
    prepared = lineariser.prepared(window, known)
    assert not lineariser.linearised(window, prepared, jumps=False).converged
    begun = LEARNER.continuation.of(window, prepared)
    assert lineariser.linearised(window, begun, jumps=False).converged


@pytest.mark.parametrize("seed", range(4))
def test_first_window_is_straight_where_parameters_are_many_times_what_is_known_of_them(seed: int) -> None:
    """Each by a factor of its own, a tenth to ten; what is left for the descent is small against an sd."""
    factors = np.exp(np.random.default_rng(seed).uniform(-np.log(10), np.log(10), len(RIG.theta)))
    window = window_with(np.zeros(8), 1.0)
    known = replace(LEARNER.prior(SIGMA, np.full(3, 0.3)), theta=factors * RIG.theta)
    lineariser = LEARNER.lineariser
    prepared = lineariser.prepared(window, known)
    assert not lineariser.linearised(window, prepared, jumps=False).converged
    before = lineariser.evaluations
    begun = LEARNER.continuation.of(window, prepared)
    assert lineariser.evaluations - before < 40
    at = lineariser.linearised(window, begun, jumps=False)
    assert at.converged
    np.testing.assert_allclose(at.theta[:3], RIG.theta[:3], rtol=1e-3)
    np.testing.assert_allclose(at.theta[3:], RIG.theta[3:], rtol=0.1)


@pytest.mark.parametrize("factor", [3.0, 1000.0])
def test_a_gain_that_is_off_as_none_is_begins_no_window(factor: float) -> None:
    """A wrong range, and millimetres for metres."""
    window = window_with(np.array([0.0, 0.0, 0.0, np.log(factor), 0.0, 0.0, 0.0, 0.0]), 1.0)
    prepared = LEARNER.lineariser.prepared(window, LEARNER.prior(SIGMA, np.full(3, 0.3)))
    begun = LEARNER.continuation.of(window, prepared)
    assert np.abs(begun.eta).max() < 0.5
    assert not LEARNER.lineariser.linearised(window, begun, jumps=False).converged
