"""The Cramer-Rao bound against a bound worked out by finite differences of the output."""

import numpy as np

from agent.numerics.fitting.information import bound_sd, expected_sd, window_information
from agent.numerics.model.statespace import simulate
from tests.unit.numerics.paper_rig import NOMINAL
from tests.unit.numerics.rigs import noisy, record, sampled


def test_window_information_equals_finite_differences_by_parameters_and_start(rng: np.random.Generator) -> None:
    truth, sigma = noisy(rng, 250, 0.0), np.array([1e-6, 3e-6])
    x0, u = truth.states[0], truth.u
    columns = []
    for i in range(8):
        step = np.eye(8)[i] * (1e-4 * NOMINAL[i] if i < 4 else 1e-4)
        up, down = (simulate(sampled(NOMINAL + s * step[:4]), x0 + s * step[4:], u)[1] for s in (1, -1))
        columns.append(((up - down) / (2 * step[i]) / sigma).ravel())
    J = np.array(columns).T
    expected = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))[:4]
    np.testing.assert_allclose(bound_sd(window_information(sampled(), x0, u, sigma)), expected, rtol=1e-5)


def test_bound_sd_nothing_known_is_infinite() -> None:
    assert np.isposinf(bound_sd(np.zeros((2, 2)))).all()
    assert np.isposinf(bound_sd(np.ones((2, 2)))).all()
    np.testing.assert_allclose(bound_sd(np.diag([4.0, 0.25])), [0.5, 2.0])


def test_expected_sd_white_force_lies_among_windows_drawn_anew(rng: np.random.Generator) -> None:
    """Windows shorter than the slowest period differ by factors, so it can only be an expectation."""
    expected = expected_sd(sampled(), np.array([5.0]), np.full(2, 1e-6), 1000)
    force, drawn = record(sampled(), 5.0 * rng.standard_normal((50_000, 1))), []
    for start in rng.integers(10_000, 49_000, 100):
        u = force.u[start : start + 1000]
        drawn.append(bound_sd(window_information(sampled(), force.states[start], u, np.full(2, 1e-6))))
    assert np.all(expected > np.quantile(drawn, 0.1, axis=0))
    assert np.all(expected < np.quantile(drawn, 0.95, axis=0))
