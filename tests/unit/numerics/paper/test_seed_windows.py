"""Sensors' gains by descent over W, windows of several lengths, and the conditions of each window."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.model.observer import poles_gain
from agent.numerics.model.sensors import Nuisance, SensedModel, with_constant
from agent.numerics.model.statespace import Model, discretise, simulate
from agent.numerics.paper.seed import Stopping
from agent.numerics.paper.seed_window import SeedSettings, SeedWindow, fit_passes
from agent.numerics.paper.seed_windows import SeedWindows
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray, Status
from tests.unit.numerics.paper_rig import NOMINAL, PERIOD, rig

POLES = [-90.0, -80.0, -70.0, -60.0]
SCALE = np.append(NOMINAL, 1.0)


def settings(model: Model, passes: int, window: int = 400) -> SeedSettings:
    nominal = discretise(model.continuous(model.nominal), PERIOD, "first")
    leant = (1,) if isinstance(model, SensedModel) else None
    gain = poles_gain(nominal.model, POLES, PERIOD, leant)
    scale = np.abs(model.nominal)
    return SeedSettings(
        PERIOD, HopPlan(window, 200), "first", gain, passes, scale, np.full(len(scale), np.inf)
    )


def record(
    model: Model, truth: FloatArray, samples: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    at = discretise(model.continuous(truth), PERIOD, "first")
    u = with_constant(rng.normal(scale=5.0, size=(samples, 1)), at.model.m)
    return simulate(at, np.zeros(at.model.n), u)[1], u


@pytest.fixture
def sensed() -> SensedModel:
    only = replace(rig(), parameters=("k2",))
    return SensedModel(only, (Nuisance("x1.gain", "gain", "output", 0),))


def test_gain_of_a_sensor_is_found_by_w_beside_the_stiffness_that_z_finds(
    sensed: SensedModel, rng: np.random.Generator
) -> None:
    truth = sensed.nominal * [1.1, 1.05]
    y, u = record(sensed, truth, 2000, rng)
    fit = fit_passes(sensed, settings(sensed, 40), y, u)
    errors = np.abs(fit.trail - truth) / truth
    assert np.all(errors[-1] < 3e-3)
    assert np.all(errors[-1] < 0.6 * errors[-11])  # and on it goes
    assert len(fit.descents) == 80  # one over Z and one over W a pass
    assert abs(fit.trail[0, 1] - 1.05) > 0.005  # one pass is not enough beside a wrong stiffness


def test_gain_alone_is_found_by_one_pass(rng: np.random.Generator) -> None:
    model = SensedModel(replace(rig(), parameters=()), (Nuisance("x1.gain", "gain", "output", 0),))
    y, u = record(model, np.array([1.05]), 1500, rng)
    assert fit_passes(model, settings(model, 1), y, u).theta == pytest.approx([1.05], abs=1e-8)


def test_conditions_of_a_window_say_what_its_descents_did(rng: np.random.Generator) -> None:
    y, u = record(rig(), NOMINAL * 1.05, 1400, rng)
    capped = replace(settings(rig(), 3), rank=1, stopping=Stopping(iterations=2))
    (at, found), *_ = SeedWindow(rig(), capped).step(0, y, u).conditions
    assert (at + 1) % 200 == 0
    assert (found.window, found.passes, found.iterations, found.converged) == (400, 3, 2, False)
    assert (found.rank, found.rank_joined, found.z_zero) == (4, 6, True)
    assert 1e-3 < found.defect <= 1.0
    assert 0.1 < found.defect_special <= 1.0
    assert found.ratio is not None
    assert np.shape(found.trail) == (3, 4)


def test_rows_of_several_windows_are_the_shortest_ones_that_are_valid(rng: np.random.Generator) -> None:
    y, u = record(rig(), NOMINAL, 1800, rng)
    y = y + rng.normal(scale=1e-7, size=y.shape)
    short, long = settings(rig(), 2, 400), settings(rig(), 2, 800)
    strict = replace(short, enough_sd=np.full(4, 1e-12))
    rows = SeedWindows([SeedWindow(rig(), strict), SeedWindow(rig(), long)]).step(0, y, u)
    assert len(rows.others) == 2
    assert rows.window[-1].tolist() == [800] * 4
    assert np.all(rows.status[-1] == Status.VALID)
    assert {found.window for _, found in rows.conditions} == {400, 800}
    plain = SeedWindows([SeedWindow(rig(), short), SeedWindow(rig(), long)]).step(0, y, u)
    assert plain.window[-1].tolist() == [400] * 4
