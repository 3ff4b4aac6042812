"""Polynomial holds against quadrature, finite differences, the earlier form of sampling and the exact
response."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.interpolate import BarycentricInterpolator
from scipy.linalg import expm
from scipy.signal import cont2discrete

from agent.numerics.model.holds import sample, straight, taps
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Hold, StateSpace, discretise, simulate
from agent.types import FloatArray
from tests.unit.numerics.model.test_statespace import widest_model
from tests.unit.numerics.readings import side_by_side
from tests.unit.numerics.rigs import measured_model, random_structure

HOLDS: list[Hold] = ["zero", "first", "cubic", "quintic"]


def one_mass() -> MassSpringDamper:
    """A resonance at 5 Hz, damping ratio 0.03."""
    structure = Structure(
        (Mass("m", 1.0),), (Element("k", ("ground", "m"), 1000.0),), (Element("B", ("ground", "m"), 1.9),)
    )
    return MassSpringDamper(structure, ("k", "B"), ("m",), (Output("displacement", "m"),))


@pytest.mark.parametrize(
    ("hold", "offsets"),
    [("zero", (0,)), ("first", (0, 1)), ("cubic", (-1, 0, 1, 2)), ("quintic", (-2, -1, 0, 1, 2, 3))],
)
def test_taps_are_one_more_than_the_degree_and_surround_the_step(
    hold: Hold, offsets: tuple[int, ...]
) -> None:
    assert taps(hold) == offsets
    assert straight(hold) == ("zero" if hold == "zero" else "first")


def test_what_is_no_hold_is_refused() -> None:
    with pytest.raises(ValueError, match='"euler" is no hold'):
        taps("euler")
    model = one_mass()
    with pytest.raises(ValueError, match=r"use holds\.sample"):
        discretise(model.continuous(model.nominal), 0.01, "cubic")


@pytest.mark.parametrize("hold", ["cubic", "quintic"])
def test_sample_equals_dense_quadrature_of_the_polynomial_through_the_readings(
    hold: Hold, rng: np.random.Generator
) -> None:
    model, T = widest_model(), 0.05
    c = model.continuous(model.nominal)
    found = sample(c, T, hold)
    x = rng.standard_normal(c.n)
    u = rng.standard_normal((len(found.taps), c.m))
    between = BarycentricInterpolator(np.array(found.taps, dtype=float), u)

    def flow(s: float) -> FloatArray:
        return np.asarray(expm(c.A * T * (1 - s)) @ c.B @ between(s) * T)

    forced, _ = quad_vec(flow, 0.0, 1.0, epsabs=1e-13, epsrel=1e-13)
    expected = expm(c.A * T) @ x + forced
    np.testing.assert_allclose(
        found.model.A @ x + found.model.B @ u.ravel(), expected, rtol=1e-11, atol=1e-12
    )
    here = u[found.taps.index(0)]
    np.testing.assert_allclose(
        found.model.C @ x + found.model.D @ u.ravel(), c.C @ x + c.D @ here, rtol=1e-12
    )


@pytest.mark.parametrize("hold", HOLDS)
def test_derivatives_of_any_hold_equal_finite_differences(hold: Hold) -> None:
    model, T = widest_model(), 0.02
    theta = model.nominal
    here = sample(model.continuous(theta), T, hold)
    for i, size in enumerate(theta):
        step = np.zeros(len(theta))
        step[i] = 1e-5 * size
        above, below = (sample(model.continuous(theta + s * step), T, hold) for s in (1, -1))
        for name in "ABCD":
            slope = (getattr(above.model, name) - getattr(below.model, name)) / (2 * step[i])
            derivative = getattr(here.model, f"d{name}")[i]
            np.testing.assert_allclose(
                derivative, slope, atol=1e-8 * max(1.0, np.abs(slope).max()), err_msg=name
            )


@pytest.mark.parametrize("hold", ["zero", "first"])
def test_run_of_a_straight_hold_is_that_of_the_shifted_form(hold: Hold, rng: np.random.Generator) -> None:
    model = measured_model(random_structure(rng, 3), ("m1", "m3"))
    c, T = model.continuous(model.nominal), 0.01
    u, x0 = rng.standard_normal((60, c.m)), rng.standard_normal(c.n)
    states, y = simulate(discretise(c, T, hold), x0, u)
    found = sample(c, T, hold)
    x = x0
    for k, v in enumerate(side_by_side(u, found.taps)):
        np.testing.assert_allclose(x, states[k], rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(found.model.C @ x + found.model.D @ v, y[k], rtol=1e-11, atol=1e-12)
        x = found.model.A @ x + found.model.B @ v


def test_zero_hold_is_scipys() -> None:
    model = one_mass()
    c = model.continuous(model.nominal)
    A, B, *_ = cont2discrete((c.A, c.B, c.C, c.D), 0.02, "zoh")
    found = sample(c, 0.02, "zero").model
    np.testing.assert_allclose(found.A, A, rtol=1e-12)
    np.testing.assert_allclose(found.B, B, rtol=1e-12)


def loss(c: StateSpace, samples_a_period: float, hold: Hold) -> float:
    """Share by which the steady response to a sine is off, against the exact one, with so many samples a
    period."""
    frequency_hz = 5.0
    period_s = 1.0 / (frequency_hz * samples_a_period)
    omega = 2 * np.pi * frequency_hz
    found = sample(c, period_s, hold)
    z = np.exp(1j * omega * period_s)
    v = np.concatenate([z**o * np.eye(c.m) for o in found.taps])
    held = found.model.C @ np.linalg.solve(z * np.eye(c.n) - found.model.A, found.model.B @ v)
    exact = c.C @ np.linalg.solve(1j * omega * np.eye(c.n) - c.A, c.B)
    return float(np.abs(held / exact - 1).max())


@pytest.mark.parametrize(
    ("hold", "least", "most"),
    [("zero", 0.2, 0.5), ("first", 0.039, 0.041), ("cubic", 0, 0.004), ("quintic", 0, 0.0004)],
)
def test_nine_samples_a_period_lose_4_percent_of_a_force_but_for_polynomials(
    hold: Hold, least: float, most: float
) -> None:
    model = one_mass()
    found = loss(model.continuous(model.nominal), 9.0, hold)
    assert least <= found <= most, found


@pytest.mark.parametrize(("hold", "order"), [("first", 2), ("cubic", 4), ("quintic", 6)])
def test_loss_falls_with_the_power_that_the_degree_promises(hold: Hold, order: int) -> None:
    model = one_mass()
    c = model.continuous(model.nominal)
    coarse, fine = (loss(c, samples, hold) for samples in (20.0, 40.0))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.15)


@pytest.mark.parametrize("hold", HOLDS)
def test_model_without_parameters_or_with_a_free_mass_is_sampled(hold: Hold) -> None:
    free = MassSpringDamper(Structure((Mass("m", 2.0),), (), ()), (), ("m",), (Output("displacement", "m"),))
    found = sample(free.continuous(np.zeros(0)), 0.5, hold)
    assert found.model.dB.shape == (0, 2, len(found.taps))
    push = np.ones(len(found.taps))  # a constant force of 1 N: x = t^2 / 4, v = t / 2
    assert sorted(np.abs(found.model.B @ push)) == pytest.approx([0.0625, 0.25])
