import builtins
import sys

import cvxpy as cp
import numpy as np
import pytest

from agent.numerics.model.mechanics import MassSpringDamper
from agent.numerics.model.statespace import discretise
from agent.numerics.paper.margins import (
    condition_3,
    condition_8,
    perturbation_norm,
    stability_margin,
)
from agent.numerics.paper.margins_box import DesignToolsMissingError, polytopic_margin, vertices
from tests.unit.numerics.paper_rig import GAIN, NOMINAL, euler, rig

FloatArray = np.typing.NDArray[np.float64]
LIMITS = np.array([15.0, 20.0, 2.0, 2.0])
C = np.hstack([np.zeros((2, 2)), np.eye(2)])


def random_stable(rng: np.random.Generator, radius: float) -> FloatArray:
    n = int(rng.integers(1, 7))
    A = rng.normal(size=(n, n)) * rng.choice([0.1, 1.0, 10.0], size=(n, n))
    return A * radius / np.max(np.abs(np.linalg.eigvals(A)))


def least_on_dense_grid(A: FloatArray) -> float:
    """The least singular value of zI - A over a grid dense everywhere and denser next to each pole."""
    poles = np.linalg.eigvals(A)
    grid = [np.linspace(0.0, np.pi, 3001)]
    for pole in poles:
        near = (1.0 - abs(pole)) * np.linspace(-3.0, 3.0, 1201)
        grid.append(np.clip(abs(np.angle(pole)) + near, 0.0, np.pi))
    z = np.exp(1j * np.concatenate(grid))
    return float(np.linalg.svd(z[:, None, None] * np.eye(len(A)) - A, compute_uv=False)[:, -1].min())


def lmi_margin(A: FloatArray) -> float:
    """Condition (8) as the paper writes it, by Clarabel."""
    n = len(A)
    P, square = cp.Variable((n, n), PSD=True), cp.Variable()
    block = cp.bmat([[A.T @ P @ A - P + square * np.eye(n), A.T @ P], [P @ A, P - np.eye(n)]])
    problem = cp.Problem(cp.Maximize(square), [0.5 * (block + block.T) << 0])
    # the square of a margin of 4e-4 is as small as its usual tolerances
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    return float(np.sqrt(square.value))


def test_stability_margin_of_the_papers_example_is_its_h_infinity_figure() -> None:
    delta = condition_8(euler(NOMINAL), GAIN, C, np.zeros((4, 4)), np.zeros((2, 4))).delta
    assert delta == pytest.approx(2.342626e-4, rel=1e-6)
    # the figure that a frequency grid gives lies a little above, since a grid misses the peak
    assert delta == pytest.approx(2.3427e-4, rel=5e-5)


def test_stability_margin_equals_the_dense_grid_on_fifty_random_systems(rng: np.random.Generator) -> None:
    for _ in range(50):
        A = random_stable(rng, 1.0 - 10.0 ** rng.uniform(-6.0, -0.3))
        exact, grid = stability_margin(A), least_on_dense_grid(A)
        assert exact <= grid * (1 + 1e-9)
        assert exact == pytest.approx(grid, rel=1e-5)


def test_stability_margin_equals_the_lmi_by_clarabel_on_fifty_random_systems(
    rng: np.random.Generator,
) -> None:
    for _ in range(50):
        A = random_stable(rng, 1.0 - 10.0 ** rng.uniform(-3.0, -0.3))
        assert stability_margin(A) == pytest.approx(lmi_margin(A), rel=1e-3)


def test_stability_margin_of_blocks_is_that_of_the_whole(rng: np.random.Generator) -> None:
    A, observer = euler(NOMINAL), euler(NOMINAL) - GAIN @ C
    whole = np.block([[A, np.zeros((4, 4))], [np.zeros((4, 4)), observer]])
    delta = condition_8(A, GAIN, C, np.zeros((4, 4)), np.zeros((2, 4))).delta
    assert stability_margin(whole) == pytest.approx(delta, rel=1e-9)


@pytest.mark.parametrize("distance", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.3, 3.0, np.pi])
def test_stability_margin_of_a_normal_matrix_is_its_distance_to_the_circle(
    distance: float, angle: float
) -> None:
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    assert stability_margin((1.0 - distance) * rotation) == pytest.approx(distance, rel=1e-6)


def test_stability_margin_of_an_unstable_or_free_model_is_zero() -> None:
    assert stability_margin(np.array([[1.0, 1e-3], [0.0, 1.0]])) == 0.0
    assert stability_margin(np.array([[1.1]])) == 0.0


def test_condition_8_does_not_cover_the_papers_own_case_and_condition_3_does() -> None:
    dA = euler(NOMINAL + np.array([25.0, 50.0, 0.0, 0.0])) - euler(NOMINAL)
    eight = condition_8(euler(NOMINAL), GAIN, C, dA, np.zeros((2, 4)))
    assert eight.perturbation_norm == pytest.approx(0.0418, abs=5e-5)
    assert not eight.holds
    assert eight.perturbation_norm / eight.delta == pytest.approx(178, abs=1)
    assert eight.h_infinity == pytest.approx(1 / eight.delta)
    three = condition_3(euler(NOMINAL), GAIN, C, dA)
    assert three.holds
    assert three.radius_observer == pytest.approx(0.97, abs=1e-5)


def test_condition_8_with_a_perturbation_just_inside_and_outside() -> None:
    delta = stability_margin(euler(NOMINAL))
    for share, holds in ((0.999, True), (1.001, False)):
        dC = np.zeros((2, 4))
        dA = np.zeros((4, 4))
        dA[0, 0] = delta * share / np.sqrt(2)
        assert condition_8(euler(NOMINAL), GAIN, C, dA, dC).holds is holds


def test_perturbation_norm_is_that_of_the_written_out_matrix(rng: np.random.Generator) -> None:
    dA, dC = rng.normal(size=(4, 4)), rng.normal(size=(2, 4))
    whole = np.block([[dA, np.zeros((4, 4))], [GAIN @ dC - dA, np.zeros((4, 4))]])
    assert perturbation_norm(GAIN, dA, dC) == pytest.approx(np.linalg.norm(whole, 2))


def test_polytopic_margin_of_the_papers_rig_is_in_its_units_and_certified() -> None:
    margin = polytopic_margin(rig(), LIMITS)
    assert margin.lyapunov is not None
    assert np.linalg.eigvalsh(margin.lyapunov)[0] > 0
    for corner in vertices(rig(), margin.share * LIMITS):
        half = margin.lyapunov @ rig().continuous(corner).A
        assert np.linalg.eigvalsh(half + half.T)[-1] < 0
    assert margin.share == pytest.approx(0.4650, abs=0.001)
    assert margin.reach["k1"] == pytest.approx(15.0 * margin.share)
    assert margin.reach["B2"] == pytest.approx(2.0 * margin.share)


def test_polytopic_margin_serves_random_courses_inside_the_box(rng: np.random.Generator) -> None:
    margin = polytopic_margin(rig(), LIMITS, accuracy=0.01)
    P, x = margin.lyapunov, rng.normal(size=4)
    assert P is not None
    for _ in range(500):
        theta = NOMINAL + margin.share * LIMITS * rng.uniform(-1, 1, size=4)
        after = discretise(rig().continuous(theta), 0.01, "zero").model.A @ x
        assert after @ P @ after < x @ P @ x
        x = after / np.linalg.norm(after)


def test_polytopic_margin_of_an_unstable_model_is_zero() -> None:
    free = rig(NOMINAL * [1.0, 1.0, -2.0, 1.0])
    margin = polytopic_margin(free, LIMITS)
    assert (margin.share, margin.lyapunov) == (0.0, None)
    assert margin.reach["k1"] == 0.0


def test_polytopic_margin_of_masses_is_refused() -> None:
    base = rig()
    with_mass = MassSpringDamper(base.structure, ("k1", "m1"), base.forces, base.outputs)
    with pytest.raises(ValueError, match="not affine"):
        polytopic_margin(with_mass, np.array([15.0, 1.0]))


def test_polytopic_margin_without_its_extra_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_cvxpy(name: str, *args: object, **kwargs: object) -> object:
        if name == "cvxpy":
            raise ImportError(name)
        return real(name, *args, **kwargs)  # type: ignore[arg-type]

    monkeypatch.delitem(sys.modules, "cvxpy")
    monkeypatch.setattr(builtins, "__import__", without_cvxpy)
    with pytest.raises(DesignToolsMissingError, match=r"pip install 'deltak\[design\]'"):
        polytopic_margin(rig(), LIMITS)
