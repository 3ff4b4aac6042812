"""Observer gains against their definitions, and observability against structures whose answer is known."""

import numpy as np
import pytest

from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure
from agent.numerics.model.observer import poles_gain, start_gain, unobservable_states
from agent.numerics.model.riccati import spectral_radius
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
