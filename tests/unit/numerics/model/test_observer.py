"""Observer gains against their definitions, and observability against structures where the answer is known."""

import numpy as np
import pytest

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.observer import kalman_gain, poles_gain, spectral_radius, start_gain, unobservable_states
from agent.numerics.model.statespace import Discrete, StateSpace
from tests.unit.numerics.paper_rig import PERIOD, rig
from tests.unit.numerics.rigs import disturbance, sampled


def chain(outputs: tuple[Output, ...]) -> MassSpringDamper:
    structure = Structure(
        (Mass("a", 1.0), Mass("b", 1.0)), (Element("k", ("a", "b"), 4.0),), (Element("B", ("a", "b"), 0.1),)
    )
    return MassSpringDamper(structure, ("k",), ("a",), outputs)


def test_poles_gain_paper_poles_are_where_they_were_asked_for() -> None:
    poles = [-45.0, -40.0, -35.0, -30.0]
    model = sampled().model
    gain = poles_gain(model, poles, PERIOD)
    placed = np.sort(np.linalg.eigvals(model.A - gain @ model.C))
    np.testing.assert_allclose(placed, np.exp(np.array(poles) * PERIOD), rtol=1e-9)


def test_poles_gain_wrong_number_is_refused() -> None:
    with pytest.raises(ValueError, match="3 poles for 4 states; give 4"):
        poles_gain(sampled().model, [-1.0, -2.0, -3.0], PERIOD)


def test_kalman_gain_equals_the_recursion_run_to_its_end() -> None:
    model = sampled().model
    direction = disturbance(rig())
    Q, R, P = direction @ direction.T * 1e-6, np.diag([1e-12, 4e-12]), np.eye(4)
    for _ in range(20_000):
        K = model.A @ P @ model.C.T @ np.linalg.inv(model.C @ P @ model.C.T + R)
        P = (model.A - K @ model.C) @ P @ (model.A - K @ model.C).T + K @ R @ K.T + Q
    gain, S = kalman_gain(model, Q, R)
    np.testing.assert_allclose(gain, K, rtol=1e-7)
    np.testing.assert_allclose(S, model.C @ P @ model.C.T + R, rtol=1e-7)


def test_kalman_gain_hidden_mode_that_grows_is_refused() -> None:
    none = np.zeros((0, 2, 2))
    model = StateSpace(
        np.diag([1.1, 0.5]), np.ones((2, 1)), np.array([[0.0, 1.0]]), np.zeros((1, 1)), none, none, none, none
    )
    with pytest.raises(ValueError, match="no stabilising"):
        kalman_gain(model, np.eye(2), np.eye(1))
    with pytest.raises(ValueError, match="no stabilising"):
        start_gain(Discrete(model, np.zeros((2, 1)), none, 0.01), np.eye(2), np.ones(1), 100)


@pytest.mark.parametrize("window", [100, 1000, 20_000])
@pytest.mark.parametrize("scale", [1e-7, 1.0])
def test_start_gain_slowest_pole_forgets_within_the_window(window: int, scale: float) -> None:
    discrete = sampled()
    gain = start_gain(discrete, disturbance(rig()), np.array([scale, scale]), window)
    radius = spectral_radius(discrete.model.A - gain @ discrete.model.C)
    assert radius**window < np.exp(-5.9)
    # no more correction than that where it is the gain that sets the pole
    if radius > spectral_radius(discrete.model.A) ** 1.01:
        assert radius**window > np.exp(-12.0)


def test_unobservable_states_displacement_of_one_mass_shows_all() -> None:
    model = rig()
    assert unobservable_states(model.continuous(model.nominal), model.state_names) == []


def test_unobservable_states_velocities_alone_hide_where_a_free_rig_is() -> None:
    model = chain((Output("velocity", "a"), Output("velocity", "b")))
    hidden = unobservable_states(model.continuous(model.nominal), model.state_names)
    assert hidden == ["displacement of a", "displacement of b"]


def test_unobservable_states_mass_without_connection_is_named() -> None:
    structure = Structure((Mass("a", 1.0), Mass("b", 1.0)), (Element("k", ("a", "ground"), 4.0),), ())
    model = MassSpringDamper(structure, (), ("a",), (Output("displacement", "a"),))
    hidden = unobservable_states(model.continuous(model.nominal), model.state_names)
    assert hidden == ["velocity of b", "displacement of b"]
