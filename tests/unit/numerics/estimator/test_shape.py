"""How the constants' mixture enters rows: at the sensitivity of the windows that the point rests on."""

from dataclasses import replace

import numpy as np

from agent.numerics.estimator.operating_point import operating_point
from agent.numerics.inference.mixture import NORMAL_975, interval95
from agent.numerics.inference.posterior import shifted
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

RIG = ChainRig()
NOISE = DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))


def test_interval_of_a_row_like_those_the_point_rests_on_is_that_of_the_mixture() -> None:
    """Two explanations tie: the interval holds each of them as surely as one alone, with one middle."""
    learner, rng = learner_of(RIG), np.random.default_rng(4)
    known = learner.prior(NOISE.sigma, np.full(2, 0.3))
    for _ in range(4):
        posterior, known = learner.learn(record(RIG, rng, NOISE)[0], known)
    constants = known.constants
    names = [h.name for h in constants.hypotheses]
    tied = [names.index("as configured"), names.index("all outputs")]
    weight = np.full(len(names), 1e-6)
    weight[tied] = 0.5
    off = np.zeros_like(constants.mean)
    off[tied[1]] = 0.1 * constants.hypotheses[tied[1]].off[0].members
    narrow = np.array([1e-6 * np.eye(len(known.eta))] * len(names))
    known = replace(
        known, constants=replace(constants, weight=weight / weight.sum(), mean=off, covariance=narrow)
    )
    own = posterior.sd_repeat
    point = operating_point(learner.rig, known, posterior, learner.sources, learner.window, own)
    mixture, assumed = known.constants, known.footing
    assert assumed is not None
    S = assumed.sensitivity
    means = shifted(known.theta, (mixture.mean - known.eta) @ S.T)
    mean, P = mixture.standing
    far = means - shifted(known.theta, S @ (mean - known.eta))
    second_order = (
        0.5 * far**2 / known.theta
    )  # which explanations so far from where the model is straight neglect
    assert second_order[tied].max() > own.min()
    spread = np.sqrt(own**2 + np.einsum("ia,hab,ib->hi", S, mixture.covariance, S) + second_order**2)
    lower, upper = interval95(mixture.weight, means, spread)
    by_constants = np.sqrt(np.einsum("ia,ab,ib->i", S, P, S))
    shape = point.shape
    half = NORMAL_975 * np.sqrt(own**2 + (shape.share * by_constants) ** 2) + shape.apart * by_constants
    middle = shifted(known.theta, S @ (mean - known.eta)) + shape.centre * by_constants
    open_to = by_constants > 0.1 * own
    assert open_to.any()
    np.testing.assert_allclose((middle - half)[open_to], lower[open_to], rtol=1e-6)
    np.testing.assert_allclose((middle + half)[open_to], upper[open_to], rtol=1e-6)
