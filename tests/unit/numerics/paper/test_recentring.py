"""Re-centring: the ratio of its steps is foretold, springs converge, a voice coil has a curve of fixed
points."""

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.config import load
from agent.numerics.model.observer import poles_gain
from agent.numerics.model.statespace import Hold, Model, discretise, simulate
from agent.numerics.paper.recentring import Recentring, independence, recentring
from agent.numerics.paper.seed_window import SeedSettings, SeedWindow, fit_passes
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray, Reason, Status
from tests.peers import ROOT
from tests.unit.numerics.paper_rig import rig as springs

COIL_T, COIL = 5e-4, np.array([4.8, 400.0, 1.5, 5.0])
POLES = np.array([-600.0, -500.0, -400.0])
WINDOW = 600


def coil() -> Model:
    return rig_model(load(ROOT / "deploy/examples/voice_coil.toml")).model


def record(model: Model, truth: FloatArray, period_s: float, hold: Hold) -> tuple[FloatArray, FloatArray]:
    """Return u (N, m), y (N, p) of a rig at rest that a random input begins to push."""
    rng = np.random.default_rng(4)
    at = discretise(model.continuous(truth), period_s, hold)
    u = 4.0 * rng.standard_normal((3 * WINDOW, at.model.m))
    return u, simulate(at, np.zeros(at.model.n), u)[1]


def foretold(model: Model, truth: FloatArray, poles: FloatArray, period_s: float, hold: Hold) -> Recentring:
    at = discretise(model.continuous(truth), period_s, hold).model
    nominal = discretise(model.continuous(model.nominal), period_s, hold).model
    gain = poles_gain(nominal, poles.tolist(), period_s)
    u, _ = record(model, truth, period_s, hold)
    return recentring(at, gain, np.abs(model.nominal), u, np.zeros(at.n), WINDOW)


def settings(model: Model, poles: FloatArray, passes: int, period_s: float, hold: Hold) -> SeedSettings:
    nominal = discretise(model.continuous(model.nominal), period_s, hold).model
    scale = np.abs(model.nominal)
    gain = poles_gain(nominal, poles.tolist(), period_s)
    return SeedSettings(period_s, HopPlan(WINDOW, WINDOW), hold, gain, passes, scale, 0.03 * scale)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_ratio_of_steps_near_the_truth_is_the_one_foretold(times: float) -> None:
    model = springs()
    poles, truth = times * np.array([-135.0, -120.0, -105.0, -90.0]), model.nominal * 1.02
    u, y = record(model, truth, 1e-3, "first")
    trail = fit_passes(model, settings(model, poles, 12, 1e-3, "first"), y, u).trail
    errors = np.linalg.norm((trail - truth) / truth, axis=1)
    found = foretold(model, truth, poles, 1e-3, "first")
    assert found.converges
    assert errors[9] / errors[8] == pytest.approx(found.ratio, rel=0.15)


def test_springs_converge_sooner_the_faster_the_observer() -> None:
    model = springs()
    ratios = [
        foretold(model, model.nominal, times * np.array([-135.0, -120.0, -105.0, -90.0]), 1e-3, "first").ratio
        for times in (1.0, 2.0, 4.0)
    ]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] < 0.5


@pytest.mark.parametrize("times", [2.0, 4.0])
def test_voice_coil_has_more_unknowns_than_the_correction_has_equations(times: float) -> None:
    """One output, three states: three products for four parameters; by the first-order model exactly."""
    euler = foretold(coil(), COIL, times * POLES, COIL_T, "euler")
    assert np.abs(euler.eigenvalues - 1.0).min() < 1e-9
    assert euler.independent < 1e-9
    exact = foretold(coil(), COIL, times * POLES, COIL_T, "first")
    assert np.abs(exact.eigenvalues - 1.0).min() < 1e-3
    assert not exact.converges


def test_voice_coil_under_a_slow_observer_is_pushed_away() -> None:
    found = foretold(coil(), COIL, 1.2 * POLES, COIL_T, "first")
    assert found.ratio > 1.2


@pytest.mark.parametrize("passes", [1, 10, 60])
def test_rows_that_re_centring_leaves_beside_the_truth_have_diverged(passes: int) -> None:
    model = coil()
    u, y = record(model, COIL, COIL_T, "first")
    rows = SeedWindow(model, settings(model, 4.0 * POLES, passes, COIL_T, "first")).step(0, y, u)
    assert abs(rows.theta[-1, 0] - 4.8) > 0.5
    assert np.all(rows.status[-1] == int(Status.INVALID))
    assert np.all(rows.reason[-1] == int(Reason.DIVERGED))


def test_parameter_that_the_gain_does_not_reach_leaves_nothing_independent() -> None:
    at = discretise(coil().continuous(COIL), COIL_T, "euler").model
    assert independence(at, np.array([[0.0], [1.0], [1.0]])) == 0.0
