"""Where few windows are learnt from, one that tells little is passed over."""

from dataclasses import replace

import numpy as np

from agent.numerics.estimator.sliding import SlidingEstimator
from tests.unit.numerics.estimator.test_sliding import estimator
from tests.unit.numerics.rigs import Record, noisy, record, sampled

WINDOW, DRIVEN, REST, SIGMA = 500, 18_000, 4_000, 1e-4


def learnt_from(ml: SlidingEstimator, samples: Record) -> list[int]:
    """Samples that end the windows learnt from."""
    found = []
    for first in range(0, len(samples.y), 50):
        before = ml.explainer.schedule.learnt
        ml.step(first, samples.y[first : first + 50], samples.u[first : first + 50])
        if ml.explainer.schedule.learnt != before:
            found.append(ml.explainer.schedule.tried)
    return found


def let_go(rng: np.random.Generator, samples: int) -> Record:
    """The driven rig, whose force is 0 from DRIVEN on for REST samples."""
    u = noisy(rng, samples, 0.0).u
    u[DRIVEN : DRIVEN + REST] = 0.0
    truth = record(sampled(), u)
    return replace(truth, y=truth.y + SIGMA * rng.standard_normal(truth.y.shape))


def test_window_of_a_machine_let_go_is_not_learnt_from_when_it_is_due(rng: np.random.Generator) -> None:
    samples = let_go(rng, DRIVEN + REST + 4_000)
    ml = estimator(WINDOW, sigma=SIGMA)
    found = learnt_from(ml, samples)
    due = [index for index in found if index < DRIVEN][-1] + 8 * WINDOW
    assert DRIVEN + WINDOW < due < DRIVEN + REST  # the motion dies out when the next window is due
    after = [index for index in found if index >= DRIVEN]
    assert after
    assert after[0] >= DRIVEN + REST
    assert after[0] < due + 8 * WINDOW
