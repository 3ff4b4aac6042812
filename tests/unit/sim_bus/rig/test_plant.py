"""The true motion against closed forms and against brute force."""

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from sim_bus.rig.plant import Graph, Link, PlantError, equations, propagate, step

FloatArray = NDArray[np.float64]
PAPER = {"m1": 5.0, "m2": 3.0, "k1": 25.0, "k2": 100.0, "B1": 5.0, "B2": 5.0}
TWO = Graph(
    ("m1", "m2"),
    (Link("k1", ("ground", "m1")), Link("k2", ("m1", "m2"))),
    (Link("B1", ("ground", "m1")), Link("B2", ("m1", "m2"))),
)
ONE = Graph(("m",), (Link("k", ("ground", "m")),), (Link("b", ("m", "ground")),))


def free_decay(m: float, k: float, b: float, x0: float, v0: float, t: FloatArray) -> FloatArray:
    rate, wd = b / (2 * m), np.sqrt(k / m - (b / (2 * m)) ** 2)
    return np.exp(-rate * t) * (x0 * np.cos(wd * t) + (v0 + rate * x0) / wd * np.sin(wd * t))


def test_propagate_single_mass_free_decay_is_the_analytic_solution() -> None:
    values = {"m": 2.0, "k": 300.0, "b": 1.5}
    states = propagate(step(equations(ONE, values), 1e-3), np.array([0.01, -0.2]), np.zeros((5001, 1)))
    expected = free_decay(2.0, 300.0, 1.5, 0.01, -0.2, np.arange(5001) * 1e-3)
    np.testing.assert_allclose(states[:, 0], expected, atol=1e-14)


def test_equations_paper_numbers_have_the_poles_of_the_characteristic_polynomial() -> None:
    m1, m2, k1, k2, b1, b2 = (PAPER[name] for name in ("m1", "m2", "k1", "k2", "B1", "B2"))
    first, second = np.poly1d([m1, b1 + b2, k1 + k2]), np.poly1d([m2, b2, k2])
    coupling = np.poly1d([b2, k2])
    expected = np.sort_complex((first * second - coupling * coupling).roots)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(equations(TWO, PAPER).F)), expected, rtol=1e-10
    )


def test_propagate_constant_force_ends_at_the_static_deflection() -> None:
    forces = np.zeros((60_001, 2))
    forces[:, 1] = 7.0
    last = propagate(step(equations(TWO, PAPER), 1e-3), np.zeros(4), forces)[-1]
    np.testing.assert_allclose(last, [7 / 25, 7 / 25 + 7 / 100, 0, 0], atol=1e-7)


def test_propagate_sum_of_forces_gives_the_sum_of_motions(rng: np.random.Generator) -> None:
    steps = step(equations(TWO, PAPER), 1e-3)
    one, other = rng.normal(size=(2, 700, 2))
    start = rng.normal(size=4)
    both = propagate(steps, start, one + other)
    apart = propagate(steps, start, one) + propagate(steps, np.zeros(4), other)
    np.testing.assert_allclose(both, apart, atol=1e-13)


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_step_force_between_samples_agrees_with_fine_integration(hold: str, rng: np.random.Generator) -> None:
    motion, dt = equations(TWO, PAPER), 0.05
    forces = rng.normal(size=(6, 2)) * 5

    def slope(t: float, x: FloatArray, k: int) -> FloatArray:
        part = t / dt if hold == "first" else 0.0
        return np.asarray(motion.F @ x + motion.G @ (forces[k] + part * (forces[k + 1] - forces[k])))

    state = np.array([0.01, -0.02, 0.1, 0.0])
    exact = propagate(step(motion, dt, hold), state, forces)
    for k in range(5):
        state = solve_ivp(slope, (0, dt), state, args=(k,), rtol=1e-11, atol=1e-13).y[:, -1]
        np.testing.assert_allclose(exact[k + 1], state, atol=1e-9)


def test_propagate_free_motion_loses_as_much_energy_as_the_dampers_take() -> None:
    graph = Graph(
        ("a", "b", "c"),
        (Link("k1", ("ground", "a")), Link("k2", ("a", "b")), Link("k3", ("b", "c")), Link("k4", ("a", "c"))),
        (Link("d1", ("a", "b")), Link("d2", ("c", "ground"))),
    )
    values = {
        "a": 1.0,
        "b": 2.0,
        "c": 0.5,
        "k1": 30.0,
        "k2": 40.0,
        "k3": 10.0,
        "k4": 5.0,
        "d1": 0.7,
        "d2": 0.3,
    }
    x = propagate(
        step(equations(graph, values), 1e-4), np.array([0.1, 0, -0.1, 0, 1.0, 0]), np.zeros((20_001, 3))
    )
    q, v = x[:, :3], x[:, 3:]
    stretch = [
        (q[:, 0], "k1"),
        (q[:, 0] - q[:, 1], "k2"),
        (q[:, 1] - q[:, 2], "k3"),
        (q[:, 0] - q[:, 2], "k4"),
    ]
    energy = sum(values[k] * e**2 / 2 for e, k in stretch)
    energy += sum(values[name] * v[:, i] ** 2 / 2 for i, name in enumerate("abc"))
    power = values["d1"] * (v[:, 0] - v[:, 1]) ** 2 + values["d2"] * v[:, 2] ** 2
    lost = np.concatenate([[0], np.cumsum((power[1:] + power[:-1]) / 2 * 1e-4)])
    np.testing.assert_allclose(energy + lost, energy[0], rtol=1e-6)


def test_equations_massless_node_moves_as_the_limit_of_a_small_mass() -> None:
    springs = (Link("k1", ("ground", "a")), Link("k2", ("a", "b")))
    dampers = (Link("d1", ("ground", "a")), Link("d2", ("a", "b")))
    values = {"a": 0.0, "b": 2.0, "k1": 50.0, "k2": 80.0, "d1": 4.0, "d2": 3.0}
    light = Graph(("a", "b"), springs, dampers, frozenset({"a"}))
    forces = np.column_stack([np.sin(np.arange(2001) * 0.01), np.cos(np.arange(2001) * 0.02)])
    massless = propagate(step(equations(light, values), 1e-3), np.zeros(3), forces)
    heavy = equations(Graph(("a", "b"), springs, dampers), values | {"a": 1e-9})
    almost = propagate(step(heavy, 1e-3), np.zeros(4), forces)
    np.testing.assert_allclose(massless[:, :2], almost[:, :2], atol=1e-9)


def test_equations_massless_node_without_damper_is_refused() -> None:
    graph = Graph(("a", "b"), (Link("k", ("a", "b")),), (Link("d", ("b", "ground")),), frozenset({"a"}))
    with pytest.raises(PlantError, match="needs a damper"):
        equations(graph, {"b": 1.0, "k": 1.0, "d": 1.0})


@pytest.mark.parametrize("count", [1, 127, 128, 129, 1000])
def test_propagate_blocks_equal_one_step_after_another(count: int, rng: np.random.Generator) -> None:
    steps = step(equations(TWO, PAPER), 1e-3)
    forces, state = rng.normal(size=(count + 1, 2)), rng.normal(size=4)
    states = propagate(steps, state, forces)
    for k, (before, after) in enumerate(itertools.pairwise(forces)):
        state = steps.A @ state + steps.B0 @ before + steps.B1 @ after
        np.testing.assert_allclose(states[k + 1], state, atol=1e-13)


def test_output_acceleration_is_the_slope_of_the_velocity() -> None:
    motion = equations(TWO, PAPER)
    h, j = motion.output("acceleration", "m2")
    steps = step(motion, 1e-5)
    start, force = np.array([0.01, 0.02, 0.3, -0.4]), np.array([[1.0, 2.0], [1.0, 2.0]])
    after = propagate(steps, start, force)[1]
    assert h @ start + j @ force[0] == pytest.approx((after[3] - start[3]) / 1e-5, rel=1e-3)
