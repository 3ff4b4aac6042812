"""The two methods that `deltak paper` compares on the paper's rig: the paper's own, and the product's."""

from dataclasses import replace

import numpy as np

from agent.evaluation.paper import cases
from agent.evaluation.tuning import ROUNDING_M
from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.model.uncertain import Rig
from agent.numerics.paper.seed import read_off
from agent.numerics.paper.seed_window import SeedSettings
from agent.numerics.preprocessing.wire import Wire
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import FloatArray, Status


def seed_settings(window: int, passes: int, hop: int = 1, settled: float = 1e-9) -> SeedSettings:
    """Return the method as printed: Euler model, printed gain, Z = 0, parameters from row 1 of (24)."""
    return SeedSettings(
        period_s=cases.PERIOD_S, plan=HopPlan(window, hop), hold="euler", gain=cases.GAIN, passes=passes,
        scale=cases.NOMINAL, enough_sd=0.033 * cases.NOMINAL, settled=settled, rank=1, read=_read,
    )  # fmt: skip


def _read(matrix: FloatArray) -> FloatArray:
    return read_off(matrix, cases.MASS_1, cases.PERIOD_S)


def product_rows(y: FloatArray, window: int, hop: int) -> Outcome:
    """Run window-ml over displacements y (N, 2) without a force."""
    estimator = SlidingEstimator(_product_settings(window, hop))
    return estimator.step(0, y, np.zeros((len(y), 1)))


def valid_changes(rows: Outcome) -> FloatArray:
    """Return estimate minus nominal of each row (N, 4), NaN in rows that are not valid."""
    return np.where(rows.status == Status.VALID, rows.theta - cases.NOMINAL, np.nan)


def _product_settings(window: int, hop: int) -> EstimatorSettings:
    """The paper's rig with its constants exact, as the paper takes them, and noise not stated.

    Its data have no noise at all; a floor far below any sensor's keeps rounding from being taken for a
    change.
    """
    model = replace(cases.rig(), forces=("m2", "m1", "m2"))
    rig = Rig(
        model, 4, np.arange(1), np.ones(1, dtype=bool), np.array([1, 2]), (), cases.PERIOD_S, "zero",
        cases.NOMINAL, 0.02 * cases.NOMINAL,
    )  # fmt: skip
    return EstimatorSettings(
        rig=rig, plan=HopPlan(window, hop), longer=(), sigma=np.full(2, np.nan),
        sigma_spread=np.full(2, np.nan),
        floor=np.full(2, ROUNDING_M), enough_sd=0.033 * cases.NOMINAL, wanted_sd=0.01 * cases.NOMINAL,
        wire=Wire.in_si(2),
    )  # fmt: skip
