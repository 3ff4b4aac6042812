"""The rivals of the comparison work: what they are compared by would mean nothing if they were broken."""

import numpy as np
import pytest

from agent.evaluation.compare import joint, rivals
from agent.numerics.model.statespace import discretise
from tests.bench.contenders import gain
from tests.bench.scene import NOMINAL, PERIOD, Record, play, rig, two_pasts

CHANGE = np.array([4.0, -8.0, 0.8, -0.5])


@pytest.fixture(scope="module")
def record() -> Record:
    return play(np.tile(NOMINAL + CHANGE, (3000, 1)), 1e-6, np.random.default_rng(7))


@pytest.mark.parametrize("change", [(25.0, 50.0, 0.0, 0.0), (0.0, 0.0, -3.0, -3.0), (50.0, -25.0, 0.0, 0.0)])
def test_polynomial_of_the_sampled_model_is_exact_over_the_scenes_changes(change: tuple[float, ...]) -> None:
    polynomial, delta = rivals.Polynomial(rig(), PERIOD), np.array(change)
    exact = discretise(rig().continuous(NOMINAL + delta), PERIOD, "first").model
    derivatives = polynomial.derivatives(delta)
    assert np.allclose(
        polynomial.matrix(delta, derivatives), np.hstack([exact.A, exact.B]), rtol=0, atol=1e-9
    )
    assert np.allclose(derivatives, np.concatenate([exact.dA, exact.dB], axis=2), rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("run", [joint.run_ekf, joint.run_ukf])
def test_joint_filter_finds_constant_parameters_within_its_own_interval(run, record: Record) -> None:
    polynomial = rivals.Polynomial(rig(), PERIOD)
    theta, sd = run(polynomial, 1e-6, rivals.Tuning(1e-6), record.y, record.u)
    error = np.abs(theta[-1] - NOMINAL - CHANGE)
    assert np.all(error < 4 * sd[-1])
    assert np.all(error < 0.02 * NOMINAL)


def test_joint_filters_agree_with_each_other(record: Record) -> None:
    polynomial = rivals.Polynomial(rig(), PERIOD)
    short = (record.y[:1000], record.u[:1000])
    (ekf, _), (ukf, _) = (
        f(polynomial, 1e-6, rivals.Tuning(1e-4), *short) for f in (joint.run_ekf, joint.run_ukf)
    )
    assert np.all(np.abs(ekf[-1] - ukf[-1]) < 0.02 * NOMINAL)


def test_recursive_least_squares_without_forgetting_equals_least_squares(record: Record) -> None:
    L = gain(3.0)
    theta, _ = rivals.run_rls(rig(), PERIOD, L, 1.0, record.y, record.u)
    s = discretise(rig().continuous(NOMINAL), PERIOD, "first").model
    x = np.zeros(4)
    columns, targets = [], []
    for y, u in zip(record.y, record.u, strict=True):
        correction = L @ (y - s.C @ x - s.D @ u)
        columns.append(np.stack([dA @ x + dB @ u for dA, dB in zip(s.dA, s.dB, strict=True)], axis=1))
        targets.append(correction)
        x = s.A @ x + s.B @ u + correction
    direct = np.linalg.lstsq(np.vstack(columns), np.concatenate(targets), rcond=None)[0]
    assert np.allclose(theta[-1] - NOMINAL, direct, rtol=1e-3, atol=1e-3)


def test_two_pasts_of_the_scene_share_the_window_and_obey_the_motion() -> None:
    theta, other = NOMINAL + np.array([25.0, 50.0, 0.0, 0.0]), NOMINAL + np.array([50.0, -25.0, 0.0, 0.0])
    one, two = two_pasts(theta, other, 1000, 250, 1e-6)
    assert np.array_equal(one.y[750:], two.y[750:])
    assert np.array_equal(one.u[750:], two.u[750:])
    assert np.abs(one.y[:750] - two.y[:750]).max() > 1e-3
    assert np.abs(two.y[749] - two.y[750]).max() < 1e-3
