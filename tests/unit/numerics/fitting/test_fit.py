"""The iterated fit on samples: its linearisation by finite differences, its maximum, its limits."""

import numpy as np
import pytest

from agent.numerics.fitting.fit import Problem, fit_window, linearise
from agent.numerics.model.gains import AutomaticGains
from agent.numerics.model.observer import Gain, Noise
from agent.numerics.model.statespace import Discrete, simulate
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import KINDS, FloatArray, disturbance, gain_of, noisy, sampled

SIGMA = 1e-6


def problem(v: FloatArray) -> Problem:
    return Problem(sampled, v, NOMINAL, 0.02 * NOMINAL)


def no_gain(discrete: Discrete) -> Gain:
    return gain_of("zero", discrete, SIGMA)


@pytest.mark.parametrize("length", [20, 64, 100])
def test_linearise_zero_gain_is_the_slope_of_the_projected_output_error(length: int, rng: np.random.Generator) -> None:
    """e is the part of the output error that no initial state explains; psi its slope by theta (Golub-Pereyra)."""
    truth, d = noisy(rng, length, SIGMA), sampled()

    def left(theta: FloatArray) -> FloatArray:
        there = sampled(theta)
        free = np.array([simulate(there, x, 0 * truth.u)[1].ravel() for x in np.eye(4)]).T
        error = (truth.y - simulate(there, np.zeros(4), truth.u)[1]).ravel() / SIGMA
        return np.asarray(error - free @ np.linalg.lstsq(free, error, rcond=None)[0])

    here = linearise(d.model, no_gain(d), truth.v, np.zeros(4))
    np.testing.assert_allclose(here.e, left(NOMINAL), atol=1e-5)
    # noise makes the projected slope differ by the small second-order term that Gauss-Newton leaves out
    quiet = noisy(rng, length, 0.0)
    truth = quiet
    here = linearise(d.model, no_gain(d), quiet.v, np.zeros(4))
    for i in range(4):
        step = np.eye(4)[i] * 1e-5 * NOMINAL[i]
        slope = (left(NOMINAL - step) - left(NOMINAL + step)) / (2 * step[i])
        np.testing.assert_allclose(here.psi[:, i], slope, atol=2e-4 * np.abs(slope).max())


@pytest.mark.parametrize("kind", KINDS)
def test_linearise_two_starts_give_the_same_point(kind: str, rng: np.random.Generator) -> None:
    d, v = sampled(1.05 * NOMINAL), noisy(rng, 500, SIGMA).v
    gain = gain_of(kind, d, SIGMA)
    one, two = (linearise(d.model, gain, v, x0) for x0 in (np.zeros(4), np.array([0.5, -0.3, 0.02, 0.01])))
    sd = np.sqrt(np.diag(np.linalg.inv(one.psi.T @ one.psi)))
    a, b = (np.linalg.lstsq(w.psi, w.e, rcond=None)[0] for w in (one, two))
    np.testing.assert_allclose(a / sd, b / sd, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_fit_window_far_start_reaches_the_truth_with_any_gain(kind: str, rng: np.random.Generator) -> None:
    v = noisy(rng, 1000, 0.0, NOMINAL * [0.5, 1.5, 0.6, 1.4]).v
    gains, noise = AutomaticGains(disturbance(rig()), 1000), Noise(np.full(2, SIGMA), np.zeros(2))
    stages = [lambda d: gains.start(d, noise), lambda d: gain_of(kind, d, SIGMA)]
    fit = fit_window(problem(v), NOMINAL, np.zeros(4), stages)
    assert fit.converged
    np.testing.assert_allclose(fit.theta / NOMINAL, [0.5, 1.5, 0.6, 1.4], rtol=1e-8)


def test_fit_window_unexcited_stays_and_knows_nothing() -> None:
    fit = fit_window(problem(np.zeros((300, 3))), NOMINAL, np.zeros(4), [no_gain])
    assert np.isposinf(np.diag(fit.covariance)).all()
    np.testing.assert_allclose(fit.theta, NOMINAL)


def test_fit_window_negative_damping_stops_at_its_bound(rng: np.random.Generator) -> None:
    """The record's own damper is pushed below zero by feedback; the estimate is not."""
    v = noisy(rng, 600, 1e-7, np.array([25.0, 100.0, 5.0, -0.5])).v
    fit = fit_window(problem(v), NOMINAL, np.zeros(4), [no_gain])
    assert fit.theta[3] >= 0.02 * NOMINAL[3]
    assert np.isfinite(fit.theta).all()
