"""Delays as model parameters: derivatives, accelerations, groups of inputs, stretches that disagree."""

import numpy as np
import pytest

from agent.numerics.fitting.skew import DelayedModel, Delays, Group, combined
from agent.numerics.model.mechanics import Element, Mass, MassSpringDamper, Output, Structure


def model(*outputs: Output) -> MassSpringDamper:
    structure = Structure(
        (Mass("m1", 5.0), Mass("m2", 3.0)),
        (Element("k1", ("ground", "m1"), 25.0), Element("k2", ("m1", "m2"), 100.0)),
        (Element("B1", ("ground", "m1"), 5.0), Element("B2", ("m1", "m2"), 5.0)),
        (),
    )
    return MassSpringDamper(structure, ("k1", "k2", "B1", "B2"), ("m2",), outputs)


@pytest.mark.parametrize("group", [Group((), (0, 1)), Group((0,), ()), Group((0,), (1,))])
def test_delayed_model_derivatives_are_those_of_small_differences(group: Group) -> None:
    delayed = DelayedModel(model(Output("displacement", "m1"), Output("acceleration", "m2")), (group,), 1)
    theta = np.array([30.0, 90.0, 4.0, 6.0, 0.01])
    here = delayed.continuous(theta)
    assert delayed.nominal.tolist() == [25.0, 100.0, 5.0, 5.0, 0.0]
    for i in range(5):
        step = np.zeros(5)
        step[i] = 1e-6 * max(theta[i], 1.0)
        up, down = delayed.continuous(theta + step), delayed.continuous(theta - step)
        for name in "ABCD":
            slope = (getattr(up, name) - getattr(down, name)) / (2 * step[i])
            np.testing.assert_allclose(getattr(here, "d" + name)[i], slope, rtol=1e-6, atol=1e-6)


def test_delayed_outputs_lag_by_their_rate_of_change() -> None:
    plain = model(Output("displacement", "m1")).continuous(np.array([25.0, 100.0, 5.0, 5.0]))
    late = DelayedModel(model(Output("displacement", "m1")), (Group((), (0,)),), 1).continuous(
        np.array([25.0, 100.0, 5.0, 5.0, 0.002])
    )
    x, u = np.array([0.3, -0.2, 0.01, 0.02]), np.array([1.5, -40.0])
    velocity = plain.C @ (plain.A @ x + plain.B @ u[:1])
    np.testing.assert_allclose(late.C @ x + late.D @ u, plain.C @ x - 0.002 * velocity)


def told(delay_s: float, sd_s: float = 1e-5, *, sure: bool = True) -> Delays:
    return Delays(np.array([delay_s]), np.array([sd_s]), np.zeros(4), sure, 1.0)


def test_combined_leaves_out_the_stretch_in_which_something_changed() -> None:
    skew = combined([told(0.0037), told(0.00371), told(0.00369), told(0.02), told(0.5, sure=False)], 1e-5)
    assert skew is not None
    assert skew.stretches == 3
    assert skew.delay_s[0] == pytest.approx(0.0037, abs=1e-5)


def test_combined_sd_is_the_scatter_where_that_is_more_than_is_stated() -> None:
    skew = combined([told(0.0030), told(0.0040), told(0.0035), told(0.0037)], 1e-5)
    assert skew is not None
    assert skew.sd_s[0] == pytest.approx(np.std([3.0, 4.0, 3.5, 3.7], ddof=1) / 2 * 1e-3, rel=0.05)


def test_combined_of_a_single_stretch_says_nothing() -> None:
    assert combined([told(0.0037)], 1e-5) is None
