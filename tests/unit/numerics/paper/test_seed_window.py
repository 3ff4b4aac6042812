from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.estimator.outcome import Outcome
from agent.numerics.model.observer import matched_gain, poles_gain
from agent.numerics.model.statespace import discretise, simulate
from agent.numerics.paper.seed_window import SeedSettings, SeedWindow, fit_passes, regression, settling
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import Reason, Status
from tests.unit.numerics.paper_rig import GAIN, NOMINAL, PERIOD, free_decay, rig
from tests.unit.numerics.rigs import disturbance

TRUE = NOMINAL + np.array([5.0, -10.0, 1.0, -0.5])
FloatArray = np.typing.NDArray[np.float64]


def forced(rng: np.random.Generator, samples: int) -> tuple[FloatArray, FloatArray]:
    u = rng.normal(scale=5.0, size=(samples, 1))
    return simulate(discretise(rig(TRUE).continuous(TRUE), PERIOD, "first"), np.zeros(4), u)[1], u


def exact_settings(passes: int) -> SeedSettings:
    model = discretise(rig().continuous(NOMINAL), PERIOD, "first").model
    gain = poles_gain(model, [-90.0, -80.0, -70.0, -60.0], PERIOD)
    return SeedSettings(PERIOD, HopPlan(250, 50), "first", gain, passes, NOMINAL, np.full(4, np.inf))


def full(rows: Outcome) -> NDArray[np.bool_]:
    """(N,) whether a row is of a whole window."""
    return np.asarray((rows.status != Status.WARMING).all(axis=1))


def diverged(rows: Outcome) -> NDArray[np.bool_]:
    return np.asarray((rows.reason == Reason.DIVERGED).all(axis=1))


def rows_of(estimator: SeedWindow, y: FloatArray, u: FloatArray, cuts: list[int]) -> Outcome:
    edges = [0, *cuts, len(y)]
    pieces = [estimator.step(a, y[a:b], u[a:b]) for a, b in pairwise(edges)]
    return Outcome.joined(pieces, 4)


def test_seed_window_as_printed_is_biased_and_recentred_is_exact(rng: np.random.Generator) -> None:
    y, u = forced(rng, 2000)
    printed, recentred = (rows_of(SeedWindow(rig(), exact_settings(p)), y, u, []) for p in (1, 20))
    off_printed = np.abs(printed.theta[-1] - TRUE) / NOMINAL
    assert off_printed.max() > 0.01
    assert np.allclose(recentred.theta[-1], TRUE, rtol=1e-4)


def test_seed_window_rows_come_on_the_hop_grid_and_are_full_once_settled(rng: np.random.Generator) -> None:
    y, u = forced(rng, 1200)
    settings = exact_settings(1)
    rows = rows_of(SeedWindow(rig(), settings), y, u, [])
    assert np.array_equal(rows.index, np.arange(49, 1200, 50))
    model = discretise(rig().continuous(NOMINAL), PERIOD, "first").model
    wait = settling(model, settings.gain, settings.settled) + 250
    assert np.array_equal(full(rows), rows.index + 1 >= wait)
    assert np.all(np.isnan(rows.theta[~full(rows)]))


@pytest.mark.parametrize("passes", [1, 3])
def test_seed_window_does_not_depend_on_how_the_stream_is_cut(rng: np.random.Generator, passes: int) -> None:
    y, u = forced(rng, 1500)
    y = y + rng.normal(scale=1e-6, size=y.shape)
    whole = rows_of(SeedWindow(rig(), exact_settings(passes)), y, u, [])
    cut = rows_of(SeedWindow(rig(), exact_settings(passes)), y, u, [1, 49, 50, 260, 333, 1000, 1270, 1290])
    assert np.array_equal(whole.index, cut.index)
    assert np.array_equal(full(whole), full(cut))
    seen = full(whole)
    assert np.all(np.abs(whole.theta[seen] - cut.theta[seen]) < 1e-9 * whole.sd[seen])


def test_seed_window_after_a_gap_waits_again(rng: np.random.Generator) -> None:
    y, u = forced(rng, 1500)
    estimator = SeedWindow(rig(), exact_settings(1))
    assert full(estimator.step(0, y[:1000], u[:1000]))[-1]
    estimator.start_segment()
    assert not full(estimator.step(1200, y[1200:], u[1200:])).any()


def test_seed_window_that_runs_away_gives_no_figure() -> None:
    _, y = free_decay(NOMINAL + np.array([4000.0, 0.0, -100.0, 0.0]), 1500)
    settings = SeedSettings(PERIOD, HopPlan(250, 50), "euler", GAIN, 12, NOMINAL / 100.0, np.full(4, np.inf))
    rows = rows_of(SeedWindow(rig(), settings), y, np.zeros((1500, 1)), [])
    assert diverged(rows)[full(rows)].all()
    assert np.all(np.isnan(rows.theta[diverged(rows)]))


def test_seed_window_passes_that_have_not_settled_are_diverged_whatever_their_last_step(
    rng: np.random.Generator,
) -> None:
    """An observer that corrects little takes small steps far from the truth, each with a small sd."""
    y, u = forced(rng, 3000)
    y = y + rng.normal(scale=1e-6, size=y.shape)
    discrete = discretise(rig().continuous(NOMINAL), PERIOD, "first")
    slow = matched_gain(discrete, disturbance(rig()), np.full(2, 1e-6), np.full(2, 1e-4))
    settings = replace(exact_settings(3), gain=slow, settled=1e-3)
    found = fit_passes(rig(), settings, y, u)
    assert np.any(np.abs(found.theta - TRUE) > 3 * found.sd)
    rows = rows_of(SeedWindow(rig(), settings), y, u, [])
    assert diverged(rows)[full(rows)].all()


def test_seed_window_settled_passes_hold_the_truth_within_their_sd(rng: np.random.Generator) -> None:
    y, u = forced(rng, 2000)
    y = y + rng.normal(scale=1e-6, size=y.shape)
    rows = rows_of(SeedWindow(rig(), exact_settings(20)), y, u, [])
    settled = full(rows) & ~diverged(rows)
    assert settled.sum() > 0.5 * full(rows).sum()
    assert np.mean(np.abs(rows.theta[settled] - TRUE) < 3 * rows.sd[settled]) > 0.9


def test_settling_of_an_unstable_observer_is_refused() -> None:
    model = discretise(rig().continuous(NOMINAL), PERIOD, "euler").model
    with pytest.raises(ValueError, match="not stable"):
        settling(model, -GAIN, 1e-9)


@pytest.mark.parametrize(("hold", "columns"), [("euler", 4), ("zero", 5), ("first", 5)])
def test_regression_takes_the_input_in_where_its_matrix_depends_on_the_parameters(
    hold: str, columns: int
) -> None:
    model = discretise(rig().continuous(NOMINAL), PERIOD, hold).model
    batch, derivatives = regression(model, np.ones((11, 4)), np.ones((10, 1)))
    assert batch.regressors.shape == (10, columns)
    assert derivatives.shape == (4, 4, columns)
