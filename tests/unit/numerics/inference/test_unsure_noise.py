"""Noise not known yet: what a window says of the constants counts for less, as what it says of the rig."""

from dataclasses import replace

import numpy as np
import pytest

from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, record

RIG = ChainRig((2.0,), (50.0,), (3.0,), 0.02, ("displacement",))
NOISE = DenseNoise(np.array([3e-3]), np.zeros(1))


def test_intensities_that_are_not_known_temper_what_a_window_says_of_constants() -> None:
    learner = learner_of(RIG, 400)
    window, *_ = record(RIG, np.random.default_rng(2), NOISE, 400)
    known = knowledge(learner, NOISE)
    at = learner.lineariser.linearised(window, known, jumps=False)

    def information(added: float) -> np.ndarray:
        spread = np.zeros_like(known.noise.spread)
        spread[0] = added  # share of every parameter's variance that an intensity leaves open
        unsure = replace(known, noise=replace(known.noise, spread=spread))
        said = learner._information(at, unsure)
        return np.concatenate([said.S.ravel(), said.g])

    assert np.abs(information(0.0)).max() > 0
    np.testing.assert_allclose(information(2.0), information(0.0) / 3.0)
    np.testing.assert_allclose(information(-0.5), information(0.0))


def test_rows_are_wider_by_the_same() -> None:
    learner = learner_of(RIG, 400)
    window, *_ = record(RIG, np.random.default_rng(2), NOISE, 400)
    known = knowledge(learner, NOISE)
    sure = learner.solve(window, known)[0].sd_repeat
    spread = np.zeros_like(known.noise.spread)
    spread[0] = 2.0
    unsure = learner.solve(window, replace(known, noise=replace(known.noise, spread=spread)))[0].sd_repeat
    assert unsure / sure == pytest.approx(np.full(2, np.sqrt(3.0)), rel=0.02)
