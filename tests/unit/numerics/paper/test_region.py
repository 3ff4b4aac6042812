"""The worst point of a box of parameters against brute force, planted defects, and an LMI."""

import numpy as np
import pytest
from scipy.linalg import expm

from agent.numerics.model.statespace import AffineModel, StateSpace
from agent.numerics.paper.region import (
    hidden_mode,
    perturbation,
    radius_of_model,
    radius_of_observer,
    worst_in_box,
)
from agent.types import FloatArray
from tests.unit.numerics.rigs import measured_model, random_structure

PERIOD_S = 0.01


def affine(A: FloatArray, C: FloatArray, dA: FloatArray, dC: FloatArray, nominal: FloatArray) -> AffineModel:
    """A model without inputs whose parameters move A and C."""
    q, n, p = len(nominal), len(A), len(C)
    at = StateSpace(
        A, np.zeros((n, 0)), C, np.zeros((p, 0)), dA, np.zeros((q, n, 0)), dC, np.zeros((q, p, 0))
    )
    return AffineModel(tuple(f"p{i}" for i in range(q)), nominal, at, tuple(f"x{i}" for i in range(n)))


def rig(seed: int, parameters: int) -> tuple[AffineModel, FloatArray]:
    """A random stable model, and a box in which its slowest pole may cross the imaginary axis."""
    rng = np.random.default_rng([seed, 30])
    n = int(rng.integers(2, 6))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
    dA = rng.standard_normal((parameters, n, n))
    return affine(A, np.eye(n), dA, np.zeros((parameters, n, n)), np.ones(parameters)), np.full(
        parameters, 0.3
    )


def radii(model: AffineModel, thetas: FloatArray) -> FloatArray:
    """Spectral radii of many points at once, by the test's own sums and numpy's exponential."""
    at = model.at_nominal
    A = at.A + np.tensordot(thetas - model.nominal, at.dA, axes=1)
    return np.asarray(np.exp(PERIOD_S * np.linalg.eigvals(A).real.max(axis=1)))


def against_brute_force(seed: int, parameters: int, points: int) -> None:
    model, half = rig(seed, parameters)
    rng = np.random.default_rng([seed, 31])
    shares = rng.uniform(-1, 1, (points, parameters))
    pushed = np.where(rng.random(shares.shape) < 0.4, np.sign(shares), shares)
    found = worst_in_box(radius_of_model(model, PERIOD_S), model.nominal, half)
    brute = radii(model, model.nominal + half * np.vstack([shares, pushed])).max()
    assert found.value >= brute - 1e-6
    assert np.all(np.abs(found.theta - model.nominal) <= half * (1 + 1e-12))
    sampled = expm(PERIOD_S * model.continuous(found.theta).A)
    assert found.value == pytest.approx(np.abs(np.linalg.eigvals(sampled)).max(), abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_worst_radius_is_no_less_than_brute_force_finds(seed: int) -> None:
    against_brute_force(seed, 2 + seed % 3, 4000)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(100, 150))
def test_worst_radius_of_fifty_rigs_is_that_of_a_hundred_thousand_points(seed: int) -> None:
    against_brute_force(seed, 2 + seed % 4, 50_000)


def test_worst_radius_of_twelve_parameters_is_found() -> None:
    against_brute_force(7, 12, 4000)


def test_worst_point_may_lie_inside_the_box() -> None:
    found = worst_in_box(lambda theta: -float((theta[0] - 1.07) ** 2), np.ones(1), np.full(1, 0.3))
    assert found.theta[0] == pytest.approx(1.07, abs=1e-5)
    assert not found.at_vertex


@pytest.mark.parametrize("seed", range(5))
def test_observability_defect_planted_inside_the_box_is_found(seed: int) -> None:
    """One reading of a random combination of states loses a mode where a parameter passes a value inside the
    box."""
    rng = np.random.default_rng([seed, 32])
    n, q = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    poles = -np.arange(1.0, n + 1)
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    A = T @ np.diag(poles) @ T.T
    place = rng.uniform(-0.7, 0.7, q)
    row = rng.uniform(0.5, 1.5, n)
    row[0] = -float(
        place @ np.ones(q)
    )  # the mode shows by row[0] + sum of the parameters: nothing at `place`
    dC = np.array([(np.eye(n)[:1] @ T.T) for _ in range(q)])
    model = affine(A, row[None] @ T.T, np.zeros((q, n, n)), dC, np.zeros(q))
    found = worst_in_box(hidden_mode(model), model.nominal, np.ones(q))
    assert found.value == pytest.approx(0.0, abs=1e-5)
    assert not found.at_vertex
    assert abs(hidden_mode(model)(model.nominal)) > 1e-3


def test_springs_within_their_limits_are_observed_by_the_observer_that_runs(rng: np.random.Generator) -> None:
    model = measured_model(random_structure(rng, 2), ("m1", "m2"))
    half = 0.2 * model.nominal
    gain = np.zeros((4, 2))
    still = worst_in_box(radius_of_observer(model, 1e-3, gain), model.nominal, half)
    alone = worst_in_box(radius_of_model(model, 1e-3), model.nominal, half)
    assert still.value == pytest.approx(alone.value, abs=1e-9)
    assert worst_in_box(perturbation(model, 1e-3, gain), model.nominal, half).value > 0
    assert worst_in_box(hidden_mode(model), model.nominal, half).value < -1e-3
