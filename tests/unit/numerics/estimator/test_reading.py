"""Rows from normal equations: what constants that no window shows do to the parameters."""

import numpy as np
import pytest

from agent.numerics.estimator.reading import solved
from agent.numerics.window.solve import Normal
from agent.types import FloatArray

SAMPLES, Q = 2000, 3


def normal_of(columns: FloatArray, y: FloatArray) -> Normal:
    H, g = columns.T @ columns, columns.T @ y
    return Normal(np.column_stack([g, H])[None], np.array([y @ y]), 0.0, np.zeros((1, 2)))


def test_solution_is_that_of_dense_least_squares_with_unit_priors_on_the_constants() -> None:
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((SAMPLES, Q + 2)) * [30.0, 3.0, 0.3, 1.0, 0.1]
    y = rng.standard_normal(SAMPLES)
    d, covariance, own, by_constants = solved(normal_of(columns, y), np.zeros((Q, 2)))
    prior = np.diag([1e-6] * Q + [1.0, 1.0])
    dense = np.linalg.inv(columns.T @ columns + prior)
    np.testing.assert_allclose(covariance[0], dense, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(d[0], dense @ columns.T @ y, rtol=1e-9)
    given = np.diag(np.linalg.inv((columns.T @ columns + prior)[:Q, :Q]))
    np.testing.assert_allclose(own[0], given, rtol=1e-9)
    np.testing.assert_allclose(by_constants[0] ** 2, np.diag(dense)[:Q] - given, rtol=1e-6)


@pytest.mark.parametrize("precision", [1e3, 1e6, 1e9])
def test_scale_that_no_window_shows_stays_open_however_precise_the_readings_are(precision: float) -> None:
    """All masses, springs and dampers times c give the same motion: 5 % of it is 5 % of each parameter."""
    rng = np.random.default_rng(1)
    of_parameters = precision * rng.standard_normal((SAMPLES, Q)) @ np.diag([1.0, 0.7, 0.1])
    of_scale = of_parameters @ np.full(Q, -0.05)
    along = np.full((Q, 1), 0.05)
    columns = np.column_stack([of_parameters, of_scale + (of_parameters @ along)[:, 0]])
    _, _, _, by_constants = solved(normal_of(columns, rng.standard_normal(SAMPLES)), along)
    np.testing.assert_allclose(by_constants[0], 0.05, rtol=1e-6)
