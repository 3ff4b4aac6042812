"""The steady-state predictor by doubling."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from agent.numerics.model.riccati import NoSteadyStateError, spectral_radius, steady_predictor
from tests.unit.numerics.window.bank_rigs import bank_rig


@pytest.mark.parametrize("masses", [1, 2, 3])
@pytest.mark.parametrize("period", [1e-1, 1e-3])
def test_the_covariance_solves_the_riccati_equation(masses: int, period: float) -> None:
    rig = bank_rig(masses, period=period)
    A, C, B, D = rig.model.A, rig.model.C, 0.3 * rig.push.B, 0.3 * rig.push.D
    R, Q, S = 1e-8 * np.eye(len(C)) + D @ D.T, B @ B.T, B @ D.T
    found = steady_predictor(A, C, Q, R, S)
    scale = 1e4
    wanted = solve_discrete_are(A.T, C.T, scale**2 * Q, scale**2 * R, s=scale**2 * S) / scale**2
    sd = np.sqrt(np.diag(wanted))
    assert np.max(np.abs(found.P - wanted) / np.outer(sd, sd)) < 1e-6
    after = A @ found.P @ A.T + Q - found.K @ found.S @ found.K.T
    assert np.max(np.abs(found.P - after) / np.outer(sd, sd)) < 1e-9
    assert spectral_radius(A - found.K @ C) < 1


def test_a_free_mass_that_a_force_pushes_has_a_predictor() -> None:
    rig = bank_rig(grounded=False)
    B = rig.push.B
    found = steady_predictor(rig.model.A, rig.model.C, B @ B.T, 1e-8 * np.eye(2), B @ np.zeros((2, 2)))
    assert spectral_radius(rig.model.A - found.K @ rig.model.C) < 1


def test_a_free_mass_that_nothing_pushes_has_no_predictor() -> None:
    model = bank_rig(grounded=False).model
    n = model.n
    with pytest.raises(NoSteadyStateError, match="does not decay"):
        steady_predictor(model.A, model.C, np.zeros((n, n)), 1e-8 * np.eye(2), np.zeros((n, 2)))
