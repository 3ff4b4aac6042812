"""The two methods that `deltak paper` compares on the paper's rig: the paper's own, and the product's."""

import numpy as np

from agent.evaluation.paper import cases
from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.model.gains import AutomaticGains
from agent.numerics.paper.seed import read_off
from agent.numerics.paper.seed_window import SeedSettings
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.rows import Rows
from agent.types import FloatArray


def seed_settings(window: int, passes: int, hop: int = 1, settled: float = 1e-9) -> SeedSettings:
    """Return the method as printed: Euler model, printed gain, Z = 0, parameters from the first row of (24)."""
    return SeedSettings(
        period_s=cases.PERIOD_S, plan=HopPlan(window, hop), hold="euler", gain=cases.GAIN, passes=passes,
        scale=cases.NOMINAL, settled=settled, rank=1, read=_read,
    )  # fmt: skip


def _read(matrix: FloatArray) -> FloatArray:
    return read_off(matrix, cases.MASS_1, cases.PERIOD_S)


def product_rows(y: FloatArray, window: int, hop: int) -> Rows:
    """Run window-ml over displacements y (N, 2) without a force."""
    estimator = WindowML(cases.rig(), _product_settings(window, hop))
    return estimator.step(0, y, np.zeros((len(y), 1)))


def valid_changes(rows: Rows) -> FloatArray:
    """Return estimate minus nominal of each row (N, 4), NaN in rows that are not valid."""
    void = rows.changing | rows.mismatch | ~rows.full
    return np.where(void[:, None], np.nan, rows.theta - cases.NOMINAL)


def _product_settings(window: int, hop: int) -> WindowSettings:
    disturbance = np.vstack([np.diag([1 / cases.MASS_1, 1 / 3.0]), np.zeros((2, 2))])
    return WindowSettings(
        period_s=cases.PERIOD_S, plan=HopPlan(window, hop), hold="zero", gains=AutomaticGains(disturbance, window),
        sigma=np.full(2, np.nan), floor=np.zeros(2), scale=cases.NOMINAL, lower=0.02 * cases.NOMINAL,
        enough_sd=0.033 * cases.NOMINAL,
    )  # fmt: skip
