"""Discretisation against integration in fine steps, scipy's own, and finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import AffineModel, Hold, StateSpace, discretise, simulate, stacked
from tests.unit.numerics.rigs import measured_model, random_structure

HOLDS: list[Hold] = ["first", "zero", "euler"]


def widest_model() -> MassSpringDamper:
    """A massless node, a ring, friction, a mass among the parameters, outputs of all three quantities."""
    return MassSpringDamper(
        Structure(
            (Mass("m1", 2.0), Mass("n", 0.0), Mass("m2", 1.0)),
            (
                Element("k1", ("ground", "m1"), 80.0),
                Element("k2", ("n", "m2"), 60.0),
                Element("k3", ("m2", "m1"), 9.0),
            ),
            (
                Element("B1", ("m1", "n"), 7.0),
                Element("B2", ("n", "ground"), 3.0),
                Element("B3", ("m2", "n"), 2.0),
            ),
            (Element("Fc", ("m1", "ground"), 0.4),),
        ),
        ("k1", "k2", "k3", "B1", "B2", "B3", "m1", "m2", "Fc"),
        ("m2", "n"),
        (
            Output("displacement", "m1"),
            Output("velocity", "n"),
            Output("velocity", "m2"),
            Output("acceleration", "m1"),
        ),
    )


@pytest.mark.parametrize("hold", HOLDS)
def test_discretise_any_hold_derivatives_equal_finite_differences(hold: Hold) -> None:
    model = widest_model()
    theta, T = model.nominal, 0.02
    here = discretise(model.continuous(theta), T, hold)
    for i, size in enumerate(theta):
        step = np.zeros(len(theta))
        step[i] = 1e-5 * size
        above, below = (discretise(model.continuous(theta + s * step), T, hold) for s in (1, -1))
        for name in "ABCD":
            slope = (getattr(above.model, name) - getattr(below.model, name)) / (2 * step[i])
            derivative = getattr(here.model, f"d{name}")[i]
            np.testing.assert_allclose(
                derivative, slope, atol=1e-8 * max(1.0, np.abs(slope).max()), err_msg=name
            )
        np.testing.assert_allclose(here.dB1[i], (above.B1 - below.B1) / (2 * step[i]), atol=1e-9)


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_discretise_any_hold_equals_fine_integration(hold: Hold, rng: np.random.Generator) -> None:
    model, T, N = widest_model(), 0.05, 12
    c = model.continuous(model.nominal)
    u, x0 = rng.standard_normal((N, c.m)), rng.standard_normal(c.n)
    states, outputs = simulate(discretise(c, T, hold), x0, u)

    def force(k: int, t: float) -> np.ndarray:  # type: ignore[type-arg]
        return u[k] if hold == "zero" else u[k] + (u[k + 1] - u[k]) * (t / T - k)

    x = x0
    for k in range(N - 1):
        span = (k * T, (k + 1) * T)
        x = solve_ivp(lambda t, x, k=k: c.A @ x + c.B @ force(k, t), span, x, rtol=1e-11, atol=1e-13).y[:, -1]
        np.testing.assert_allclose(states[k + 1], x, atol=1e-9)
    np.testing.assert_allclose(outputs, states @ c.C.T + u @ c.D.T, atol=1e-10 * np.abs(outputs).max())


@pytest.mark.parametrize(("samples", "forces"), [(1, ("m2", "n")), (32, ("n",)), (75, ("m2", "n")), (75, ())])
def test_simulate_any_length_equals_the_recursion(
    samples: int, forces: tuple[str, ...], rng: np.random.Generator
) -> None:
    model = replace(widest_model(), forces=forces, structure=replace(widest_model().structure, frictions=()),
                    parameters=())  # fmt: skip
    discrete = discretise(model.continuous(model.nominal), 0.05)
    u, x0 = rng.standard_normal((samples, len(forces))), rng.standard_normal(discrete.model.n)
    states, outputs = simulate(discrete, x0, u)
    x = x0 - discrete.B1 @ u[0]
    for k in range(samples):
        np.testing.assert_allclose(states[k], x + discrete.B1 @ u[k], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(
            outputs[k], discrete.model.C @ x + discrete.model.D @ u[k], rtol=1e-11, atol=1e-11
        )
        x = discrete.model.A @ x + discrete.model.B @ u[k]


@pytest.mark.parametrize(("hold", "scipys"), [("zero", "zoh"), ("first", "foh"), ("euler", "euler")])
def test_discretise_random_graph_equals_scipy(hold: Hold, scipys: str, rng: np.random.Generator) -> None:
    structure = random_structure(rng, 4)
    model = measured_model(structure, ("m1", "m3"))
    c = model.continuous(model.nominal)
    d = discretise(c, 0.03, hold)
    A, B, C, D, _ = cont2discrete((c.A, c.B, c.C, c.D), 0.03, scipys)
    for ours, theirs in ((d.model.A, A), (d.model.B, B), (d.model.C, C), (d.model.D, D)):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_affine_model_moved_equals_sum_of_its_derivatives(rng: np.random.Generator) -> None:
    shapes = [(3, 3), (3, 1), (2, 3), (2, 1)]
    base = StateSpace(
        *(rng.standard_normal(s) for s in shapes), *(rng.standard_normal((2, *s)) for s in shapes)
    )
    model = AffineModel(("a", "b"), np.array([1.0, 2.0]), base, ("x", "y", "z"))
    moved = model.continuous(np.array([1.5, 1.0]))
    for name in "ABCD":
        d = getattr(base, f"d{name}")
        np.testing.assert_allclose(getattr(moved, name), getattr(base, name) + 0.5 * d[0] - d[1])
    assert stacked((2, 2), []).shape == (0, 2, 2)


def test_discretise_without_parameters_has_empty_derivatives() -> None:
    model = MassSpringDamper(widest_model().structure, (), ("m1",), (Output("displacement", "m1"),))
    d = discretise(model.continuous(np.zeros(0)), 0.01)
    assert d.model.dA.shape == (0, 5, 5)
    assert d.model.q == 0
