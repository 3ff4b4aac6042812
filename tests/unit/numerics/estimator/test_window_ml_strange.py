"""The estimator's stream under readings that no rig gives: none may raise, warn, or be taken for a parameter."""

import numpy as np
import pytest

from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.faults.mistakes import Mistakes
from agent.numerics.faults.suspects import ChannelSuspect
from agent.numerics.window.rows import Rows
from agent.types import Reason
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import PERIOD, FloatArray, Record, noisy, settings

WINDOW = 500


def estimator(sigma: float) -> WindowML:
    model = rig()
    believed = settings(WINDOW, 50, sigma)
    told = {name: getattr(believed, name) for name in believed.__dataclass_fields__}
    return WindowML(model, type(believed)(**{**told, "mistakes": Mistakes(model, 2, 1, PERIOD, "first")}))


def rows_of(ml: WindowML, y: FloatArray, u: FloatArray) -> Rows:
    return ml.step(0, y, u)


def force(rng: np.random.Generator, samples: int = 3000) -> FloatArray:
    return 5.0 * rng.standard_normal((samples, 1))


@pytest.mark.parametrize("sigma", [np.nan, 1e-6])
@pytest.mark.parametrize("at", [0.0, 0.01])
def test_window_ml_displacements_that_never_change_are_a_standstill(
    sigma: float, at: float, rng: np.random.Generator
) -> None:
    ml = estimator(sigma)
    rows = rows_of(ml, np.full((3000, 2), at), force(rng))
    assert rows.still[rows.full].all()
    assert not (rows.changing | rows.mismatch).any()
    assert not rows.suspect.any()
    assert not np.any(rows.sd[rows.full] < np.inf)
    assert ml.take_findings() == []


@pytest.mark.parametrize("sigma", [np.nan, 1e-6])
def test_window_ml_displacement_that_never_changed_while_the_other_moves_is_stuck(
    sigma: float, rng: np.random.Generator
) -> None:
    samples = noisy(rng, 800, 1e-6)
    samples.y[:, 0] = 0.0
    ml = estimator(sigma)
    rows = rows_of(ml, samples.y, samples.u)
    assert rows.suspect[rows.full][0] == Reason.STUCK
    assert rows.channel[rows.full][0] == 0
    assert ml.take_findings()[0][1].suspect == ChannelSuspect("stuck", (0,))


@pytest.mark.parametrize("sigma", [np.nan, 1e-6])
def test_window_ml_displacements_of_noise_alone_name_no_scale(sigma: float, rng: np.random.Generator) -> None:
    """The force moves nothing at all: how many times too large it reads is no number."""
    ml = estimator(sigma)
    rows_of(ml, 1e-6 * rng.standard_normal((800, 2)), 60.0 * rng.standard_normal((800, 1)))
    named = {getattr(found.suspect, "kind", None) for _, found in ml.take_findings()}
    assert not named & {"gain", "input gain"}


def test_window_ml_masses_that_move_while_the_force_reads_nothing_are_said_so(rng: np.random.Generator) -> None:
    samples = noisy(rng, 800, 7e-5)
    y = 12.0 * samples.y
    ml = estimator(7e-5)
    rows_of(ml, y, np.zeros((800, 1)))
    assert next(found.suspect for _, found in ml.take_findings()) == ChannelSuspect("forces", (2,))


def test_window_ml_readings_without_any_noise_are_explained(rng: np.random.Generator) -> None:
    samples = noisy(rng, 8000, 0.0)
    rows = rows_of(estimator(np.nan), samples.y, samples.u)
    assert not (rows.changing | rows.mismatch)[rows.full].any()
    assert not rows.suspect.any()
    np.testing.assert_allclose(rows.theta[rows.full], np.broadcast_to(NOMINAL, rows.theta[rows.full].shape), rtol=1e-9)
    assert np.all(rows.sd[rows.full] < 1e-5 * NOMINAL)


@pytest.mark.parametrize("factor", [1e-60, 1e60])
def test_window_ml_readings_of_no_size_leave_the_numbers_in_silence(factor: float, rng: np.random.Generator) -> None:
    """Warnings are errors here: neither numpy nor scipy may have anything to say."""
    samples = noisy(rng, 2000, 1e-6)
    spoilt = Record(factor * samples.y, samples.u, samples.states)
    rows = rows_of(estimator(1e-6), spoilt.y, spoilt.u)
    assert not np.isnan(rows.sd[rows.full]).any() or not np.isfinite(rows.theta[rows.full]).all()


