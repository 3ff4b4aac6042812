"""The sign of an unmeasured velocity: right, causal, and the same however the stream is cut."""

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.stick_slip import FrictionInputs, acting, friction_observer

PERIOD_S = 1e-3
PAIR = [("m", "ground")]


def slider(mass: float = 10.0, quantity: str = "displacement") -> MassSpringDamper:
    """Return a mass with viscous and dry friction, under a force (on a spring if its velocity is read)."""
    springs = (Element("k", ("m", "ground"), 50.0),) if quantity == "velocity" else ()
    structure = Structure(
        (Mass("m", mass),),
        springs,
        (Element("B", ("ground", "m"), 20.0),),
        (Element("Fc", ("m", "ground"), 3.0),),
    )
    return MassSpringDamper(structure, ("m", "B", "Fc"), ("m",), (Output(quantity, "m"),))  # type: ignore[arg-type]


def slide(v: float, force: float, h: float) -> float:
    """Return the velocity of 10 kg after a step under dry friction of 3 N, which may hold it."""
    free = v + h * force / 10.0
    return float(np.sign(free) * max(abs(free) - h * 3.0 / 10.0, 0.0))


def stroke(rng: np.random.Generator, noise: float) -> tuple[NDArray[np.float64], ...]:
    """Return y, u, v of a slider that is pushed to and fro, integrated in fine steps by the test itself."""
    t, fine = np.arange(6000) * PERIOD_S, 20
    u = 15.0 * np.sin(2.0 * np.pi * 0.7 * t) + 6.0 * np.sin(2.0 * np.pi * 1.9 * t)
    x, v = np.zeros(len(t)), np.zeros(len(t))
    for k in range(len(t) - 1):
        x[k + 1], v[k + 1] = x[k], v[k]
        for i in range(fine):
            force = u[k] + (u[k + 1] - u[k]) * (i + 0.5) / fine
            v[k + 1] = slide(v[k + 1], force - 20.0 * v[k + 1], PERIOD_S / fine)
            x[k + 1] += PERIOD_S / fine * v[k + 1]
    return (x + noise * rng.standard_normal(len(t)))[:, None], u[:, None], v


def test_friction_inputs_on_a_sliding_mass_have_the_sign_of_its_velocity() -> None:
    y, u, v = stroke(np.random.default_rng(1), 1e-7)
    observer = friction_observer(slider(mass=9.0), PERIOD_S, "first", np.array([1e-7]))
    signs = FrictionInputs(observer).beside(y, u)[:, 1]
    moving = np.abs(v) > 0.02
    assert np.mean(signs[moving] == np.sign(v[moving])) > 0.995
    assert np.abs(signs).max() < 3.0


def test_friction_inputs_however_the_stream_is_cut_are_the_same_to_the_bit() -> None:
    rng = np.random.default_rng(2)
    y, u, _ = stroke(rng, 1e-6)
    observer = friction_observer(slider(), PERIOD_S, "first", np.array([1e-6]))
    whole = FrictionInputs(observer).beside(y, u)
    pieces, cut, start = [], FrictionInputs(observer), 0
    while start < len(y):
        stop = start + int(rng.integers(1, 100))
        pieces.append(cut.beside(y[start:stop], u[start:stop]))
        start = stop
    assert np.array_equal(np.vstack(pieces), whole)


def test_friction_inputs_at_standstill_under_noise_are_zero() -> None:
    rng = np.random.default_rng(3)
    y = 0.5 + 1e-5 * rng.standard_normal((4000, 1))
    observer = friction_observer(slider(), PERIOD_S, "first", np.array([1e-5]))
    signs = FrictionInputs(observer).beside(y, np.zeros((4000, 1)))[:, 1]
    assert np.mean(signs[100:] == 0.0) > 0.9


def test_friction_inputs_after_a_gap_forget_what_was_before() -> None:
    y, u, _ = stroke(np.random.default_rng(4), 0.0)
    observer = friction_observer(slider(), PERIOD_S, "first", np.array([np.nan]))
    inputs = FrictionInputs(observer)
    first = inputs.beside(y[:777], u[:777])
    inputs.beside(y[1000:1500] + 3.0, u[1000:1500])
    inputs.start_segment()
    assert np.array_equal(inputs.beside(y[:777], u[:777]), first)


@pytest.mark.parametrize(
    ("speed", "free", "mean", "last"),
    [
        (0.5, 0.6, 1.0, 1.0),  # slides on
        (-0.5, -0.4, -1.0, -1.0),
        (0.1, -0.5, 0.1 / 0.7 - 0.6 / 0.7, -1.0),  # crosses zero and turns round
        (0.05, 0.05, 0.5, 0.0),  # stops within the sample, and nothing pushes
        (0.0, 0.05, 0.5, 0.5),  # is held by half of the friction
        (0.0, 0.3, 1.0, 1.0),  # breaks loose
    ],
)
def test_acting_friction_slides_turns_round_sticks_and_breaks_loose(
    speed: float, free: float, mean: float, last: float
) -> None:
    assert acting(speed, free, 0.1) == pytest.approx((mean, last))
