"""The Cramer-Rao bound against a bound worked out by finite differences of the output."""

from dataclasses import replace

import numpy as np

from agent.commissioning.numerics.information import bound_sd, predicted_sd, window_information
from agent.numerics.model.statespace import simulate
from agent.numerics.model.uncertain import Constant, Rig
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import noisy, sampled


def test_window_information_equals_finite_differences_by_parameters_and_start(
    rng: np.random.Generator,
) -> None:
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


def statistical(*constants: Constant) -> Rig:
    model, every, none = rig(), np.arange(1), np.zeros(0, dtype=np.int64)
    return Rig(model, 4, every, np.ones(1, dtype=bool), none, constants, 1e-3, "first", NOMINAL, np.zeros(4))


def test_predicted_sd_without_constants_is_the_bound(rng: np.random.Generator) -> None:
    truth, sigma = noisy(rng, 250, 0.0), np.array([1e-6, 3e-6])
    shifted = truth.states[0] - sampled().B1 @ truth.u[0]
    found = predicted_sd(statistical(), shifted, truth.u, sigma)
    bound = bound_sd(window_information(sampled(), truth.states[0], truth.u, sigma))
    np.testing.assert_allclose(found.sd, bound, rtol=1e-9)
    np.testing.assert_allclose(found.sd_repeat, bound, rtol=1e-9)


def test_predicted_sd_holds_what_the_data_sheet_leaves_open(rng: np.random.Generator) -> None:
    """All masses, springs, dampers and forces times c move alike: c is known as well as masses to 2 %, force
    to 1 %."""
    truth, sigma = noisy(rng, 4000, 0.0), np.full(2, 1e-7)
    model = replace(rig(), parameters=("k1", "k2", "B1", "B2", "m1", "m2"))
    constants = (
        Constant("m1", "mass", 0, 0.02),
        Constant("m2", "mass", 1, 0.02),
        Constant("u", "input", 0, 0.01),
    )
    shifted = truth.states[0] - sampled().B1 @ truth.u[0]
    found = predicted_sd(replace(statistical(*constants), model=model), shifted, truth.u, sigma)
    bound = bound_sd(window_information(sampled(), truth.states[0], truth.u, sigma))
    np.testing.assert_allclose(found.sd_repeat, bound, rtol=1e-6)
    common = 1 / np.sqrt(2 / 0.02**2 + 1 / 0.01**2)
    np.testing.assert_allclose(found.sd / NOMINAL, common, rtol=0.02)
