"""Inputs that are late, or held until the next reading: the sampled model with their slopes."""

import numpy as np
import pytest

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Hold, discretise
from agent.numerics.model.uncertain import CURVED, Constant, Rig, Sampled, delays_of, sampled
from agent.types import FloatArray

HELD, ONE_LATE = np.array([0.0, 0.5]), np.array([1.0, 0.0])
LATE = tuple(Constant("delay", "delay", number, 0.2) for number in (0, 1))


def rig(hold: Hold = "first") -> Rig:
    """A mass driven by a measured force, seen by its place and by an accelerometer where the force acts."""
    structure = Structure(
        (Mass("m", 2.0),), (Element("k", ("ground", "m"), 50.0),), (Element("B", ("ground", "m"), 3.0),)
    )
    outputs = (Output("displacement", "m"), Output("acceleration", "m"))
    model = MassSpringDamper(structure, ("k", "B"), ("m",), outputs)
    measured, driven = np.array([0]), np.array([True])
    return Rig(model, 2, measured, driven, measured, LATE, 0.05, hold, model.nominal, np.zeros(2))


def run(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray) -> FloatArray:
    """Readings (N, p) from rest."""
    x, out = np.zeros(len(A)), []
    for row in u:
        out.append(C @ x + D @ row)
        x = A @ x + B @ row
    return np.array(out)


def readings(at: Sampled, u: FloatArray) -> FloatArray:
    """Readings under a force that begins at 0, its slopes beside it."""
    return run(at.A, at.B, at.C, at.D, np.column_stack([u, np.diff(u, axis=0, prepend=u[:1])]))


@pytest.fixture
def force() -> FloatArray:
    return np.vstack([np.zeros((1, 1)), np.random.default_rng(3).standard_normal((40, 1))])


def test_half_a_sample_of_the_second_delay_is_an_input_that_is_held(force: FloatArray) -> None:
    line = rig()
    held = discretise(line.model.continuous(line.model.nominal), line.period_s, "zero").model
    found = readings(sampled(line, line.nominal, np.zeros(0), HELD), force)
    np.testing.assert_allclose(found, run(held.A, held.B, held.C, held.D, force), rtol=1e-11, atol=1e-13)


def test_one_sample_of_the_first_delay_is_an_input_one_sample_late(force: FloatArray) -> None:
    line = rig()
    late, at_once = (
        readings(sampled(line, line.nominal, np.zeros(0), d), force) for d in (ONE_LATE, 0 * ONE_LATE)
    )
    np.testing.assert_allclose(late[1:], at_once[:-1], rtol=1e-11, atol=1e-13)


def stepping_late(line: Rig, delay: float, u: FloatArray) -> FloatArray:
    """Readings under steps that come `delay` of a sample late, read before: two exact pieces a sample."""
    continuous = line.model.continuous(line.model.nominal)
    before, after = (
        discretise(continuous, share * line.period_s, "zero").model for share in (delay, 1 - delay)
    )
    x, out = np.zeros(before.n), []
    for old, new in zip(np.vstack([u[:1], u[:-1]]), u, strict=True):
        out.append(continuous.C @ x + continuous.D @ old)
        x = after.A @ (before.A @ x + before.B @ old) + after.B @ new
    return np.array(out)


@pytest.mark.parametrize("delay", [0.1, 0.25, 0.5, 0.75, 1.0])
def test_steps_that_come_late_are_followed_where_motion_and_where_force_is_seen(
    delay: float, force: FloatArray
) -> None:
    steps = rig("zero")
    found = readings(sampled(steps, steps.nominal, np.zeros(0), np.array([delay, 1.0])), force)
    at_once = readings(sampled(steps, steps.nominal, np.zeros(0), np.zeros(2)), force)
    truth = stepping_late(steps, delay, force)
    left, whole = (np.abs(y - truth).max(axis=0) for y in (found, at_once))
    assert (left / whole).max() < (1e-13 if delay == 1 else 0.01)


def test_steps_half_a_sample_early_are_straight_lines(force: FloatArray) -> None:
    steps, line = rig("zero"), rig()
    found, truth = (
        readings(sampled(r, r.nominal, np.zeros(0), d), force)
        for r, d in ((steps, np.array([-0.5, 0.0])), (line, np.zeros(2)))
    )
    np.testing.assert_allclose(found, truth, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize(
    ("hold", "point"), [("first", (0.3, 0.2)), ("zero", (0.3, 0.9)), ("zero", (-0.4, 0.1))]
)
def test_slopes_have_the_derivatives_by_parameters_and_by_either_delay(
    hold: Hold, point: tuple[float, float]
) -> None:
    line, step = rig(hold), 1e-5
    at = sampled(line, line.nominal, np.zeros(0), np.array(point))
    for i in range(2):
        change = np.eye(2)[i] * step
        up, down = (
            sampled(line, line.nominal + s * change * at.unit, np.zeros(0), np.array(point)) for s in (1, -1)
        )
        np.testing.assert_allclose(at.dB[i], (up.B - down.B) / (2 * step), rtol=1e-6, atol=1e-10)
        np.testing.assert_allclose(at.dD[i], (up.D - down.D) / (2 * step), rtol=1e-6, atol=1e-10)
        up, down = (sampled(line, line.nominal, np.zeros(0), point + s * change) for s in (1, -1))
        moved = np.vstack([up.B - down.B, up.D - down.D]) / (2 * step)
        assert at.late is not None
        np.testing.assert_allclose(at.late[i], moved[:, 1:], rtol=1e-6, atol=1e-10)


def test_a_smooth_force_is_followed_to_the_fourth_order_where_straight_lines_are_to_the_second() -> None:
    line = rig()
    line = Rig(**{**vars(line), "constants": (*LATE, Constant("curve", "delay", CURVED, 1.0))})
    continuous = line.model.continuous(line.model.nominal)
    omega = 2 * np.pi / (12 * line.period_s)
    turn = np.exp(1j * omega * line.period_s)
    force = np.array([1.0, 1.0 - 1.0 / turn])
    seen = continuous.C @ np.linalg.solve(1j * omega * np.eye(2) - continuous.A, continuous.B) + continuous.D
    lost = []
    for amount in (0.0, 1.0):
        at = sampled(line, line.nominal, np.zeros(0), np.array([0.0, 0.0, amount]))
        found = at.C @ np.linalg.solve(turn * np.eye(2) - at.A, at.B @ force) + at.D @ force
        lost.append(np.abs(found / seen[:, 0] - 1)[0])
    assert lost[0] > 0.02
    assert lost[1] < 0.002


def test_smooth_forces_have_the_derivatives_by_parameters_and_by_how_smooth_they_are() -> None:
    line, step, point = rig(), 1e-5, np.array([0.1, 0.2, 0.7])
    line = Rig(**{**vars(line), "constants": (*LATE, Constant("curve", "delay", CURVED, 1.0))})
    at = sampled(line, line.nominal, np.zeros(0), point)
    for i in range(2):
        change = np.eye(2)[i] * step * at.unit
        up, down = (sampled(line, line.nominal + s * change, np.zeros(0), point) for s in (1, -1))
        np.testing.assert_allclose(at.dC[i], (up.C - down.C) / (2 * step), rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(at.dD[i], (up.D - down.D) / (2 * step), rtol=1e-6, atol=1e-9)
    up, down = (sampled(line, line.nominal, np.zeros(0), point + s * np.eye(3)[2] * step) for s in (1, -1))
    assert at.curve is not None
    moved = np.hstack([up.C - down.C, up.D - down.D]) / (2 * step)
    np.testing.assert_allclose(at.curve, moved, rtol=1e-6, atol=1e-9)


def test_a_rig_whose_inputs_are_never_late_has_no_slopes() -> None:
    line = rig()
    assert delays_of(line, np.array([0.1, 0.4])) == pytest.approx([0.1, 0.4])
    given = Rig(**{**vars(line), "constants": ()})
    assert delays_of(given, np.zeros(0)) is None
    assert sampled(given, given.nominal, np.zeros(0)).B.shape == (2, 1)
