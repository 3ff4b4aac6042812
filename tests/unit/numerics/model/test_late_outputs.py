"""Outputs that are read late, each by itself: the sampled model against the motion between samples."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.model.statespace import discretise
from agent.numerics.model.uncertain import LAG, Constant, Rig, Sampled, delays_of, sampled
from agent.types import FloatArray
from tests.unit.numerics.model.test_late_inputs import readings, rig, run

FINE = 20
"""Parts of a sample at which the motion is followed."""
LAGS = (Constant("x late", "delay", LAG, 0.25), Constant("a late", "delay", LAG + 1, 0.25))


def late() -> Rig:
    """A mass seen by its place and by an accelerometer where the force acts, either of which may be late."""
    return replace(rig(), constants=LAGS)


def at(made: Rig, lags: tuple[float, float], theta: FloatArray | None = None) -> Sampled:
    delays = delays_of(made, np.array(lags))
    return sampled(made, made.nominal if theta is None else theta, np.zeros(0), delays)


@pytest.fixture
def force() -> FloatArray:
    return np.vstack([np.zeros((1, 1)), np.random.default_rng(3).standard_normal((60, 1))])


def between(made: Rig, u: FloatArray) -> FloatArray:
    """Readings (FINE (N - 1) + 1, p) under a force that runs straight between its samples."""
    places = np.arange(FINE * (len(u) - 1) + 1) / FINE
    fine = discretise(made.model.continuous(made.model.nominal), made.period_s / FINE, "first").model
    return run(fine.A, fine.B, fine.C, fine.D, np.interp(places, np.arange(len(u)), u[:, 0])[:, None])


@pytest.mark.parametrize("lags", [(0.25, 0.0), (0.0, 0.25), (0.5, 0.1), (-0.25, 0.0)])
def test_output_that_is_late_shows_the_motion_as_it_was(lags: tuple[float, float], force: FloatArray) -> None:
    made = late()
    truth = between(made, force)
    found, at_once = readings(at(made, lags), force), readings(at(made, (0.0, 0.0)), force)
    for channel, lag in enumerate(lags):
        steps = np.arange(5, len(force) - 1)
        was = truth[FINE * steps - round(FINE * lag), channel]
        left = np.abs(found[steps, channel] - was).max()
        if lag > 0 or not channel:
            assert left <= 0.2 * np.abs(at_once[steps, channel] - was).max() + 1e-12


def test_force_that_no_channel_drives_moves_what_is_late_too() -> None:
    """A constant beside the measured force: it has no slope, and its part in the speed counts."""
    one = late()
    model = replace(one.model, forces=("m", "m"))  # type: ignore[type-var]
    both = np.array([0, 1])
    made = replace(one, model=model, measured=both, driven=np.array([True, False]), pushed=both[:1])
    u = np.vstack([np.zeros((1, 2)), np.column_stack([np.zeros(60), 5 * np.ones(60)])])
    places = np.arange(FINE * (len(u) - 1) + 1) / FINE
    fine = discretise(model.continuous(model.nominal), made.period_s / FINE, "first").model
    inputs = np.column_stack([np.interp(places, np.arange(len(u)), own) for own in u.T])
    truth = run(fine.A, fine.B, fine.C, fine.D, inputs)[:, 0]
    found, at_once = readings(at(made, (0.25, 0.0)), u)[:, 0], readings(at(made, (0.0, 0.0)), u)[:, 0]
    steps = np.arange(5, len(u) - 1)
    was = truth[FINE * steps - FINE // 4]
    assert np.abs(found[steps] - was).max() <= 0.06 * np.abs(at_once[steps] - was).max()


def test_derivatives_by_parameters_are_those_of_what_is_late() -> None:
    made, lags, step = late(), (0.4, 0.2), 1e-6
    here = at(made, lags)
    for i, unit in enumerate(here.unit):
        theta = made.nominal.copy()
        theta[i] += step * unit
        there = at(made, lags, theta)
        np.testing.assert_allclose((there.C - here.C) / step, here.dC[i], rtol=1e-4, atol=1e-6)
        np.testing.assert_allclose((there.D - here.D) / step, here.dD[i], rtol=1e-4, atol=1e-6)


def test_derivatives_by_lateness_are_exact_since_it_enters_straight() -> None:
    made = late()
    here, there = at(made, (0.0, 0.0)), at(made, (1.0, 0.5))
    assert here.lag is not None
    added = np.array([1.0, 0.5])[:, None] * here.lag
    np.testing.assert_allclose(np.hstack([there.C - here.C, there.D - here.D]), added, rtol=1e-12)


def test_rig_whose_outputs_are_read_at_once_has_no_lateness() -> None:
    assert sampled(rig(), rig().nominal, np.zeros(0), np.zeros(2)).lag is None
