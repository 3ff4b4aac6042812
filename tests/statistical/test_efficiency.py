"""Errors and stated deviations of many runs against the Cramer-Rao bound of the noise that was simulated."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t as student

from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.fitting.information import bound_sd, window_information
from agent.numerics.model.statespace import discretise
from tests.unit.numerics.paper_rig import NOMINAL, PERIOD, rig
from tests.unit.numerics.rigs import Record, record, settings

FloatArray = NDArray[np.float64]
SIGMA, WINDOW, HOP = 1e-6, 1000, 250


@dataclass(frozen=True)
class Outcome:
    """Disjoint windows: errors, stated sd, bound, whether the interval holds the truth, (n, 4) each; valid rows."""

    error: FloatArray
    sd: FloatArray
    bound: FloatArray
    covered: NDArray[np.bool_]
    believed: NDArray[np.bool_]
    valid: float


def one_run(seed: int, windows: int) -> Outcome:
    """A rig up to 20 % off nominal under 5 N of white force, observed from some instant of its motion."""
    rng = np.random.default_rng([7, seed])
    theta = NOMINAL * rng.uniform(0.8, 1.2, 4)
    discrete = discretise(rig().continuous(theta), PERIOD)
    samples = windows * WINDOW
    x0 = np.concatenate([rng.normal(0, 0.1, 2), rng.normal(0, 0.02, 2)])
    truth = record(discrete, 5.0 * rng.standard_normal((samples, 1)), x0)
    noisy = Record(truth.y + SIGMA * rng.standard_normal(truth.y.shape), truth.u, truth.states)
    rows = WindowML(rig(), settings(WINDOW, HOP, SIGMA)).step(0, noisy.y, noisy.u)
    ends = np.flatnonzero((rows.index + 1) % WINDOW == 0)
    starts = rows.index[ends] + 1 - WINDOW
    sigma = np.full(2, SIGMA)
    bounds = [bound_sd(window_information(discrete, truth.states[s], truth.u[s : s + WINDOW], sigma)) for s in starts]
    usable = rows.full & ~rows.changing & ~rows.mismatch & np.isfinite(rows.theta).all(axis=1)
    half = student.ppf(0.975, rows.dof[ends])[:, None] * rows.sd[ends]
    error = rows.theta[ends] - theta
    covered = (np.abs(error) <= half) & usable[ends][:, None]
    return Outcome(error, rows.sd[ends], np.array(bounds), covered, usable[ends], float(usable[rows.full].mean()))


def many(runs: int, windows: int) -> Outcome:
    outcomes = [one_run(seed, windows) for seed in range(runs)]
    arrays = [
        np.concatenate([getattr(o, name) for o in outcomes]) for name in ("error", "sd", "bound", "covered", "believed")
    ]
    return Outcome(*arrays, valid=float(np.mean([o.valid for o in outcomes])))


def assert_efficient(outcome: Outcome, efficiency: tuple[float, float], coverage: tuple[float, float]) -> None:
    # bounds differ from window to window: every error counts in units of its own; what is not valid counts as uncovered
    good = outcome.believed
    rmse = np.sqrt(np.mean((outcome.error[good] / outcome.bound[good]) ** 2, axis=0))
    stated = np.mean(outcome.sd[good] / outcome.bound[good], axis=0) / rmse
    covered = outcome.covered.mean(axis=0)
    print(f"\nRMSE / bound {rmse}, mean sd / RMSE {stated}, coverage {covered}, valid {outcome.valid:.4f}")  # noqa: T201 (the figures that soak reports)
    assert np.all((rmse >= efficiency[0]) & (rmse <= efficiency[1])), rmse
    assert np.all((stated >= 0.9) & (stated <= 1.15)), stated
    assert np.all((covered >= coverage[0]) & (covered <= coverage[1])), covered
    assert outcome.valid >= 0.99


def test_window_ml_two_hundred_runs_reach_the_bound_and_say_so() -> None:
    assert_efficient(many(200, 2), (0.85, 1.15), (0.92, 0.98))


@pytest.mark.soak
def test_window_ml_pooled_over_thousands_of_intervals_reaches_the_bound() -> None:
    pooled = many(500, 6)
    assert len(pooled.error) >= 2000
    assert_efficient(pooled, (0.95, 1.05), (0.935, 0.965))
