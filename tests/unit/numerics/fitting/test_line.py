"""Windows along which every parameter runs a straight line."""

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.fitting import line as room
from agent.numerics.fitting.fit import Problem
from agent.numerics.fitting.line import fit_line
from tests.bench.scene import play
from tests.unit.numerics.paper_rig import NOMINAL
from tests.unit.numerics.rigs import KINDS, gain_of, sampled

FloatArray = NDArray[np.float64]
SLOPE = np.array([-4.0, 12.0, 0.8, -0.6])


def ramp(samples: int, before: int = 1000) -> FloatArray:
    """Parameters that stand still for `before` samples, then run SLOPE over `samples`, from sample to sample."""
    run = np.arange(samples)[:, None] / samples * SLOPE
    return np.vstack([np.tile(NOMINAL, (before, 1)), NOMINAL + run])


def problem(theta: FloatArray, samples: int, sigma: float, rng: np.random.Generator) -> Problem:
    record = play(theta, sigma, rng)
    return Problem(sampled, np.hstack([record.y, record.u])[-samples:], NOMINAL, np.zeros(4))


@pytest.mark.parametrize("kind", KINDS)
def test_fit_line_noise_free_ramp_is_recovered(kind: str, rng: np.random.Generator) -> None:
    told = problem(ramp(1500), 1500, 0.0, rng)
    found = fit_line(told, gain_of(kind, sampled(), 1e-6), NOMINAL, np.zeros(4))
    assert found is not None
    np.testing.assert_allclose(found.theta, NOMINAL + SLOPE, rtol=1e-5)
    np.testing.assert_allclose(found.slope, SLOPE, atol=1e-5 * NOMINAL.max())


@pytest.mark.parametrize("kind", KINDS)
def test_line_sensitivities_are_the_slopes_of_what_is_left(kind: str, rng: np.random.Generator) -> None:
    # without noise: the projection itself moves with theta, by what it leaves of the window
    told = problem(ramp(300), 300, 0.0, rng)
    gain, at = gain_of(kind, sampled(), 1e-6), np.concatenate([NOMINAL + SLOPE, SLOPE])
    here = room._at(told, gain, at)
    for i, size in enumerate(np.tile(NOMINAL, 2)):
        h = np.zeros(8)
        h[i] = 1e-4 * size
        slope = (room._at(told, gain, at - h).e - room._at(told, gain, at + h).e) / (2 * h[i])
        np.testing.assert_allclose(slope, here.psi[:, i], atol=1e-3 * np.linalg.norm(here.psi[:, i]))


def test_fit_line_errors_are_what_its_covariance_says(rng: np.random.Generator) -> None:
    theta, sigma, runs = ramp(900), 1e-5, 60
    truth = np.concatenate([NOMINAL + SLOPE, SLOPE])
    squares = np.zeros(8)
    for _ in range(runs):
        found = fit_line(problem(theta, 900, sigma, rng), gain_of("zero", sampled(), sigma), truth[:4], SLOPE)
        assert found is not None
        error = np.concatenate([found.theta, found.slope]) - truth
        squares += error**2 / np.diag(found.covariance) / runs
        assert np.sum(found.residual**2) / (1800 - 12) == pytest.approx(1.0, abs=0.2)
    assert np.all(np.abs(squares - 1.0) < 4 * np.sqrt(2 / runs))


def test_fit_line_window_without_motion_is_no_line() -> None:
    told = Problem(sampled, np.zeros((400, 3)), NOMINAL, np.zeros(4))
    assert fit_line(told, gain_of("zero", sampled(), 1e-6), NOMINAL, np.zeros(4)) is None
