"""The graph's matrices against equations typed out by hand, energy, and integration of Newton's law."""

import numpy as np
import pytest

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from tests.unit.numerics.model.test_statespace import widest_model
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import random_structure


def test_mechanics_papers_rig_equals_its_equations() -> None:
    c = rig().continuous(NOMINAL)
    k1, k2, b1, b2, m1, m2 = 25.0, 100.0, 5.0, 5.0, 5.0, 3.0
    A = [
        [-(b1 + b2) / m1, b2 / m1, -(k1 + k2) / m1, k2 / m1],
        [b2 / m2, -b2 / m2, k2 / m2, -k2 / m2],
        [1, 0, 0, 0],
        [0, 1, 0, 0],
    ]
    np.testing.assert_allclose(c.A, A)
    np.testing.assert_allclose(c.B, [[0], [1 / m2], [0], [0]])
    np.testing.assert_allclose(c.C, [[0, 0, 1, 0], [0, 0, 0, 1]])
    assert rig().state_names == (
        "velocity of m1",
        "velocity of m2",
        "displacement of m1",
        "displacement of m2",
    )


@pytest.mark.parametrize("masses", [1, 2, 4, 6])
def test_mechanics_random_graph_obeys_newton_element_by_element(
    masses: int, rng: np.random.Generator
) -> None:
    structure = random_structure(rng, masses)
    names = [m.name for m in structure.masses]
    model = MassSpringDamper(structure, (), tuple(names), tuple(Output("acceleration", n) for n in names))
    c = model.continuous(np.zeros(0))
    v, x, f = rng.standard_normal((3, masses))
    place = {"ground": (0.0, 0.0)} | {n: (x[i], v[i]) for i, n in enumerate(names)}
    force = dict(zip(names, f, strict=True)) | {"ground": 0.0}
    for spring, damper in zip(structure.springs, structure.dampers, strict=True):
        a, b = spring.between
        pull = spring.nominal * (place[b][0] - place[a][0]) + damper.nominal * (place[b][1] - place[a][1])
        force[a] += pull
        force[b] -= pull
    accelerations = [force[m.name] / m.value for m in structure.masses]
    state = np.concatenate([v, x])
    np.testing.assert_allclose(c.C @ state + c.D @ f, accelerations, rtol=1e-12)
    np.testing.assert_allclose((c.A @ state + c.B @ f)[masses:], v)


def test_mechanics_massless_node_equals_limit_of_a_small_mass() -> None:
    """Its velocity is that at which the forces on it cancel; friction is an input that acts against the
    motion."""
    model = widest_model()
    c = model.continuous(model.nominal)
    x = np.array([0.3, -0.2, 0.01, 0.02, -0.03])  # v1, v2, x1, xn, x2
    u = np.array([1.5, 0.7, 1.0])  # force on m2, force on n, sign of m1's velocity
    v1, v2, x1, xn, x2 = x
    vn = (0.7 + 60 * (x2 - xn) + 7 * v1 + 2 * v2) / (7 + 3 + 2)
    a1 = (-80 * x1 + 9 * (x2 - x1) + 7 * (vn - v1) - 0.4) / 2.0
    a2 = 1.5 + 60 * (xn - x2) + 9 * (x1 - x2) + 2 * (vn - v2)
    np.testing.assert_allclose(c.A @ x + c.B @ u, [a1, a2, v1, vn, v2], rtol=1e-12)
    np.testing.assert_allclose(c.C @ x + c.D @ u, [x1, vn, v2, a1], rtol=1e-12)


def test_mechanics_derivatives_equal_finite_differences_by_every_kind_of_parameter() -> None:
    model = widest_model()
    here = model.continuous(model.nominal)
    for i, size in enumerate(model.nominal):
        step = np.eye(len(model.nominal))[i] * 1e-5 * size
        above, below = model.continuous(model.nominal + step), model.continuous(model.nominal - step)
        for name in "ABCD":
            slope = (getattr(above, name) - getattr(below, name)) / (2 * step[i])
            np.testing.assert_allclose(
                getattr(here, f"d{name}")[i], slope, atol=1e-7, err_msg=model.parameters[i]
            )


def test_mechanics_free_rig_is_at_rest_in_translation() -> None:
    structure = Structure(
        (Mass("a", 1.0), Mass("b", 2.0)), (Element("k", ("a", "b"), 5.0),), (Element("B", ("a", "b"), 1.0),)
    )
    c = MassSpringDamper(structure, ("k",), ("a",), (Output("displacement", "a"),)).continuous(
        np.array([5.0])
    )
    np.testing.assert_allclose(c.A @ [0, 0, 1, 1], 0)


def test_mechanics_unknown_parameter_or_acceleration_without_mass_is_refused() -> None:
    structure = widest_model().structure
    with pytest.raises(ValueError, match="k9"):
        MassSpringDamper(structure, ("k9",), (), ())
    with pytest.raises(ValueError, match="acceleration"):
        MassSpringDamper(structure, (), (), (Output("acceleration", "n"),)).continuous(np.zeros(0))


def test_matrices_of_a_rig_with_known_masses_are_those_of_its_elements_at_any_theta() -> None:
    rng = np.random.default_rng(8)
    structure = random_structure(rng, 4)
    springs = tuple(e.name for e in (*structure.springs, *structure.dampers))
    places = tuple(m.name for m in structure.masses)
    outputs = (Output("displacement", "m1"), Output("velocity", "m2"), Output("acceleration", "m3"))
    model = MassSpringDamper(structure, springs, places, outputs)
    theta = model.nominal * rng.uniform(0.2, 3.0, len(springs))
    straight, assembled = model.continuous(theta), model._assembled(theta)
    for name in ("A", "B", "C", "D", "dA", "dB", "dC", "dD"):
        found, wanted = getattr(straight, name), getattr(assembled, name)
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * np.abs(assembled.A).max())
