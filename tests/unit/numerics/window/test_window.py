"""The window's solution in Gram form against samples, and its independence of everything before the window."""

import numpy as np
import pytest

from agent.numerics.fitting.fit import linearise
from agent.numerics.model.sensitivity import SensitivityFilter
from agent.numerics.window.cells import Summary, cell_operators, merge, summarise_cells
from agent.numerics.window.solution import solve_windows
from tests.unit.numerics.paper_rig import NOMINAL
from tests.unit.numerics.rigs import KINDS, FloatArray, filters, gain_of, noisy, sampled

SIGMA = 1e-6
REFERENCE = NOMINAL * [1.02, 0.99, 0.97, 1.01]


def summary_of(f: SensitivityFilter, v: FloatArray, z: FloatArray, cell: int = 25) -> Summary:
    """One window, cell by cell."""
    operator = cell_operators(f, [cell])[cell]
    total = None
    for start in range(0, len(v), cell):
        inputs = v[start : start + cell].reshape(1, -1)
        piece = summarise_cells(operator, inputs, z[None])
        total = piece if total is None else merge(total, piece)
        z = operator.state_from_state @ z + inputs[0] @ operator.state_from_inputs
    assert total is not None
    return total


def after(f: SensitivityFilter, v: FloatArray) -> FloatArray:
    z = np.zeros(len(f.F))
    for sample in v:
        z = f.F @ z + f.N @ sample
    return z


@pytest.mark.parametrize("kind", KINDS)
def test_solve_windows_identical_data_two_pasts_gives_the_same_estimate(kind: str, rng: np.random.Generator) -> None:
    """Held fixed: theta_r, the gain, the window's samples. Different: all samples before it, and so the observer's
    and the sensitivities' states at its start. Compared: the solution of the window, in its standard deviations.
    """
    d = sampled(REFERENCE)
    f = filters(d, gain_of(kind, d, SIGMA))
    window, deltas = noisy(rng, 500, SIGMA).v, []
    pasts = [np.zeros((1, 3)), noisy(rng, 800, SIGMA).v, noisy(rng, 300, SIGMA, 1.5 * NOMINAL).v * 2.0]
    for past in pasts:
        solution = solve_windows(summary_of(f, window, after(f, past)), 4)
        deltas.append(solution.delta[0])
    sd = np.sqrt(np.diag(solution.covariance[0]))
    np.testing.assert_allclose(deltas[1] / sd, deltas[0] / sd, atol=1e-9)
    np.testing.assert_allclose(deltas[2] / sd, deltas[0] / sd, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_solve_windows_gram_form_equals_least_squares_on_samples(kind: str, rng: np.random.Generator) -> None:
    d = sampled(REFERENCE)
    gain = gain_of(kind, d, SIGMA)
    f = filters(d, gain)
    v = noisy(rng, 400, SIGMA).v
    z = np.zeros(20)
    z[:4] = 1e-3
    solution = solve_windows(summary_of(f, v, z), 4)
    left = linearise(d.model, gain, v, z[:4])
    delta, residual, _, _ = np.linalg.lstsq(left.psi, left.e, rcond=None)
    sd = np.sqrt(np.diag(np.linalg.inv(left.psi.T @ left.psi)))
    np.testing.assert_allclose(solution.delta[0] / sd, delta / sd, atol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(solution.covariance[0])), sd, rtol=1e-6)
    np.testing.assert_allclose(solution.residual[0], residual[0], rtol=1e-6)
    np.testing.assert_allclose(solution.e0[0], left.e0, atol=1e-6 * np.abs(left.e0).max())


def test_solve_windows_wrong_start_is_found_as_the_states_error(rng: np.random.Generator) -> None:
    truth, d = noisy(rng, 500, 0.0), sampled()
    f = filters(d, gain_of("zero", d, SIGMA))
    wrong, z = np.array([1e-2, -2e-2, 1e-3, 5e-4]), np.zeros(20)
    z[:4] = truth.states[0] - d.B1 @ truth.u[0] + wrong
    solution = solve_windows(summary_of(f, truth.v, z), 4)
    np.testing.assert_allclose(solution.e0[0], -wrong, rtol=1e-6)
    np.testing.assert_allclose(solution.delta[0] / NOMINAL, 0, atol=1e-7)


def test_solve_windows_silent_window_says_nothing_and_a_prior_is_what_is_left() -> None:
    d = sampled()
    f = filters(d, gain_of("kalman", d, SIGMA))
    silent = summary_of(f, np.zeros((100, 3)), np.zeros(20))
    solution = solve_windows(silent, 4)
    assert np.isnan(solution.delta).all()
    assert np.isposinf(np.diag(solution.covariance[0])).all()
    assert solution.residual[0] == 0.0
    told = solve_windows(silent, 4, prior=np.array([1.0, 4.0, 1.0, 1.0]))
    np.testing.assert_allclose(told.delta, 0, atol=1e-12)
    np.testing.assert_allclose(np.diag(told.covariance[0]), [1, 0.25, 1, 1])
