"""Windows that are solved and not learnt from."""

import numpy as np

from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

RIG = ChainRig((2.0,), (50.0,), (3.0,), 0.02, ("displacement",))
NOISE = DenseNoise(np.array([3e-3]), np.zeros(1))


def test_a_window_solved_after_it_was_learnt_from_says_the_same() -> None:
    learner = learner_of(RIG, 400)
    window, *_ = record(RIG, np.random.default_rng(2), NOISE, 400)
    learnt, known = learner.learn(window, learner.prior(NOISE.sigma, np.full(1, 0.3)))
    solved, _ = learner.solve(window, known)
    np.testing.assert_allclose(solved.sd / learnt.sd, 1.0, atol=0.02)
    np.testing.assert_allclose((solved.theta - learnt.theta) / learnt.sd, 0.0, atol=0.02)
