"""Doubling against scipy's solver wherever that works, and where it does not against the equation itself."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from agent.numerics.model.riccati import steady_covariance

FloatArray = np.ndarray


def drawn(rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A model of 2-10 states, some of its poles outside the unit circle, 1-3 outputs, full process noise."""
    n = int(rng.integers(2, 11))
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.5, 1.3) / np.abs(np.linalg.eigvals(A)).max()
    C, push = rng.normal(size=(int(rng.integers(1, 4)), n)), rng.normal(size=(n, n))
    return A, C, push @ push.T


def defect(A: FloatArray, C: FloatArray, Q: FloatArray, P: FloatArray) -> float:
    """How far P is from what one more sample makes of it, relative."""
    S = C @ P @ C.T + np.eye(len(C))
    again = A @ P @ A.T - A @ P @ C.T @ np.linalg.solve(S, C @ P @ A.T) + Q
    return float(np.linalg.norm(again - P) / np.linalg.norm(P))


def test_steady_covariance_equals_scipys_on_random_models(rng: np.random.Generator) -> None:
    compared = 0
    for _ in range(200):
        A, C, Q = drawn(rng)
        try:
            expected = solve_discrete_are(A.T, C.T, Q, np.eye(len(C)))
        except (np.linalg.LinAlgError, ValueError):
            continue
        if defect(A, C, Q, expected) > 1e-12:
            continue
        found = steady_covariance(A, C, Q)
        assert found is not None
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
        compared += 1
    assert compared > 150


@pytest.mark.parametrize("decades", [0, 4, 8])
def test_steady_covariance_states_and_outputs_of_any_unit_solve_the_equation(
    decades: int, rng: np.random.Generator
) -> None:
    for _ in range(50):
        A, C, Q = drawn(rng)
        A *= 0.999 / np.abs(np.linalg.eigvals(A)).max()
        unit = 10.0 ** rng.uniform(-decades, decades, len(A))
        P = steady_covariance(A * unit[:, None] / unit, C / unit, Q * np.outer(unit, unit))
        assert P is not None
        assert defect(A, C, Q, P / np.outer(unit, unit)) < 1e-10


def test_steady_covariance_poles_on_the_unit_circle_settles() -> None:
    """A free mass under an unknown force, its displacement measured: two poles at 1, known gain at unit
    intensity."""
    A, C = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    push = np.array([[0.5], [1.0]])
    for intensity in (1e-12, 1e-6, 1.0, 1e6):
        Q = intensity**2 * push @ push.T
        P = steady_covariance(A, C, Q)
        assert P is not None
        assert defect(A, C, Q, P) < 1e-9
        L = A @ P @ C.T / (C @ P @ C.T + 1.0)
        assert np.abs(np.linalg.eigvals(A - L @ C)).max() < 1.0


def test_steady_covariance_hidden_mode_that_grows_has_none() -> None:
    assert steady_covariance(np.diag([1.1, 0.5]), np.array([[0.0, 1.0]]), np.eye(2)) is None
