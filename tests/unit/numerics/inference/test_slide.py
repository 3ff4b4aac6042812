"""A gain that drifts does so inside a window too: that is no jump of the parameters, and moves them."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.inference.posterior import Knowledge, Posterior
from agent.numerics.inference.spectral.columns import Window
from tests.unit.numerics.estimator.test_bank_is_frequency import only
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, record

RIG = ChainRig()
NOISE = DenseNoise(np.array([1e-6, 1e-6]), np.zeros(2))
LEARNER = learner_of(RIG)


def believed(name: str) -> Knowledge:
    known = knowledge(LEARNER, NOISE)
    return replace(known, constants=only(known.constants, name)) if name else known


def window_of(growth: float, jump: float = 0.0) -> Window:
    """A window whose first output's gain grows by so much."""
    window, *_ = record(RIG, np.random.default_rng(4), NOISE)
    place = (np.arange(window.length) + 0.5) / window.length - 0.5
    y = window.y.copy()
    y[:, 0] *= 1 + growth * place + jump * (place > 0.1)
    return replace(window, y=y)


def solved(name: str, growth: float, jump: float = 0.0) -> Posterior:
    return LEARNER.solve(window_of(growth, jump), believed(name))[0]


def fitted(known: Knowledge, growth: float) -> np.ndarray:
    """Parameters of such a window at the point known, the constants estimated beside them."""
    at = LEARNER.at_point(window_of(growth), known)
    nb = at.regression.layout.base
    fit = np.linalg.solve(at.G[:nb, :nb] + at.ridge.R, at.G[:nb, -1] + at.ridge.b)
    return at.theta + at.unit * fit[at.regression.layout.psi]


def test_nothing_slides_where_no_drift_is_believed() -> None:
    assert believed("as configured").constants.slide == (0, 0.0)
    posterior = solved("as configured", 0.0)
    assert posterior.slide == 0.0
    assert not posterior.slid.any()


def test_the_gain_that_drifts_slides_by_its_walk() -> None:
    known = believed("x1 drifts")
    number, size = known.constants.slide
    assert known.constants.hypotheses[0].off[0].members[number] == 1
    assert size == pytest.approx(float(np.sqrt(known.constants.hypotheses[0].walk[number, number])))


def test_a_slide_is_a_jump_unless_a_drift_is_believed() -> None:
    size = believed("x1 drifts").constants.slide[1]
    assert solved("as configured", size).changing
    assert not solved("x1 drifts", size).changing


@pytest.mark.parametrize("steps", [1.0, 2.0, 4.0])
def test_a_slide_of_more_than_its_walk_counts_by_the_square_of_it(steps: float) -> None:
    size = believed("x1 drifts").constants.slide[1]
    assert solved("x1 drifts", steps * size).jump.max() < max(steps**2, 4.0)


def test_what_a_slide_does_to_the_parameters_is_in_their_sds() -> None:
    known = believed("x1 drifts")
    size = known.constants.slide[1]
    at = LEARNER.at_point(window_of(size), known)
    found = LEARNER._posterior(at, known, known.constants)
    moved = fitted(known, size) - fitted(known, 0.0)
    np.testing.assert_allclose(found.slid, moved, rtol=0.1)
    without = LEARNER._posterior(replace(at, slide=None), known, known.constants)
    np.testing.assert_allclose(found.sd_repeat**2 - without.sd_repeat**2, found.slid**2, rtol=1e-6)


def test_a_jump_beside_a_slide_is_one() -> None:
    size = believed("x1 drifts").constants.slide[1]
    assert solved("x1 drifts", size, jump=0.05).changing
