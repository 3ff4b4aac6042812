"""Readings stacked for polynomial holds, and the sampled model that takes them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from agent.numerics.estimator.look_ahead import LookAhead, Ready
from agent.numerics.model.holds import taps
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.statespace import Hold
from agent.numerics.model.uncertain import Rig, sampled
from tests.unit.numerics.readings import side_by_side

HOLDS: list[Hold] = ["cubic", "quintic"]


def rig(hold: Hold) -> Rig:
    """A mass driven by a measured force; a second input of the model is no channel's, a third an unknown
    force."""
    structure = Structure(
        (Mass("m", 2.0),), (Element("k", ("ground", "m"), 50.0),), (Element("B", ("ground", "m"), 3.0),)
    )
    model = MassSpringDamper(structure, ("k", "B"), ("m", "m", "m"), (Output("displacement", "m"),))
    columns, driven = np.array([0, 1]), np.array([True, False])
    return Rig(model, 2, columns, driven, np.array([2]), (), 0.05, hold, model.nominal, np.zeros(2))


def stacked(hold: Hold, u: np.ndarray, cuts: list[int]) -> list[Ready]:
    ahead, found = LookAhead(rig(hold)), []
    missing = np.zeros((len(u), 2), dtype=bool)
    missing[7, 1] = True
    edges = [0, *cuts, len(u)]
    for a, b in pairwise(edges):
        found.append(ahead.step(100 + a, u[a:b, :1], u[a:b], missing[a:b], None))
    return found


@pytest.mark.parametrize("hold", HOLDS)
@pytest.mark.parametrize("cuts", [[], [1, 2, 3, 9], list(range(1, 20))])
def test_samples_wait_for_their_later_readings_however_they_come(hold: Hold, cuts: list[int]) -> None:
    u = np.random.default_rng(1).standard_normal((20, 2))
    found = [ready for ready in stacked(hold, u, cuts) if len(ready.y)]
    offsets = taps(hold)
    padded = np.vstack([np.repeat(u[:1], -offsets[0], axis=0), u])[:, :1]
    expected = np.delete(side_by_side(padded, offsets), offsets.index(0), axis=1)
    count = 20 - offsets[-1]
    v = np.vstack([ready.u for ready in found])
    np.testing.assert_array_equal(v[:, :2], u[:count])
    np.testing.assert_array_equal(v[:, 2:], expected)
    np.testing.assert_array_equal(np.vstack([ready.y for ready in found]), u[:count, :1])
    index = np.concatenate([ready.index + np.arange(len(ready.y)) for ready in found])
    np.testing.assert_array_equal(index, 100 + np.arange(count))
    lost = np.vstack([ready.missing for ready in found if ready.missing is not None])
    assert np.argwhere(lost).tolist() == [[7, 1]]


def test_a_segment_begins_with_its_own_first_reading_and_nothing_of_the_last() -> None:
    ahead, u = LookAhead(rig("cubic")), np.arange(10.0)[:, None] * np.ones(2)
    ahead.step(0, u[:, :1], u, None, None)
    ahead.forget()
    ready = ahead.step(50, u[4:, :1], u[4:], None, None)
    assert ready.index == 50
    assert ready.u[0].tolist() == [4.0, 4.0, 4.0, 5.0, 6.0]


@pytest.mark.parametrize("hold", ["first", "zero"])
def test_holds_of_one_reading_pass_samples_at_once(hold: Hold) -> None:
    u = np.ones((3, 2))
    ready = LookAhead(rig(hold)).step(5, u[:, :1], u, None, None)
    assert (ready.index, ready.u.shape, ready.missing) == (5, (3, 2), None)


@pytest.mark.parametrize("hold", HOLDS)
def test_inputs_of_no_channel_and_unknown_forces_stay_straight_lines(hold: Hold) -> None:
    polynomial, line = rig(hold), rig("first")
    point = polynomial.nominal, np.zeros(0)
    found, straight = sampled(polynomial, *point), sampled(line, *point)
    for name in ("B", "D", "dB", "dD"):
        np.testing.assert_allclose(getattr(found, name)[..., 1], getattr(straight, name)[..., 1])
    for name in ("A", "C", "E", "F", "dA", "dC"):
        np.testing.assert_allclose(getattr(found, name), getattr(straight, name))


@pytest.mark.parametrize("hold", HOLDS)
def test_stacked_derivatives_are_those_of_the_stacked_model(hold: Hold) -> None:
    polynomial, step = rig(hold), 1e-5
    at = sampled(polynomial, polynomial.nominal, np.zeros(0))
    for i in range(2):
        change = np.eye(2)[i] * step * at.unit
        up, down = (sampled(polynomial, polynomial.nominal + s * change, np.zeros(0)) for s in (1, -1))
        np.testing.assert_allclose(at.dB[i], (up.B - down.B) / (2 * step), rtol=1e-6, atol=1e-10)


def test_a_gain_acts_on_every_tap_of_its_input() -> None:
    polynomial = rig("cubic")
    assert polynomial.taps_of(0).tolist() == [0, 2, 3, 4]
    assert polynomial.taps_of(1).tolist() == [1]
    assert replace(polynomial, hold="first").taps_of(0).tolist() == [0]
