"""Windows in which nothing moves: what the outputs show is their own noise."""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.fitting.noise import sensor_noise
from agent.numerics.window.hops import Segment
from agent.numerics.window.rows import Rows

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
STILL = 1.5
"""An output whose deviations in a window are no larger than so many times its noise does not move."""


def still(point: WorkingPoint, segment: Segment, rows: Rows) -> BoolArray:
    """(N,) rows that know nothing and in whose windows no output moves."""
    found = np.zeros(len(rows.index), dtype=bool)
    with np.errstate(invalid="ignore"):
        blind = rows.full & ~np.any(rows.sd <= point.settings.enough_sd, axis=1)
    window = point.settings.plan.window
    asked = np.flatnonzero(blind & (rows.index - segment.first >= window - 1))
    if not len(asked):
        return found
    start, stop = int(rows.index[asked[0]]) - window + 1, int(rows.index[asked[-1]]) + 1
    y = segment.samples(start, stop)[:, : point.outputs]
    ends = rows.index[asked] - start + 1
    found[asked] = np.all(_deviations(y, ends, window) <= STILL * _noise(point, y, ends), axis=1)
    return found


def _noise(point: WorkingPoint, y: FloatArray, ends: NDArray[np.int64]) -> FloatArray:
    """(N, p) or (p,) noise of each output: as it is known, else as the fastest differences in each window show it."""
    known = point.noise.sigma if point.settled else point.settings.sigma
    if np.all(np.isfinite(known)):
        return np.maximum(known, point.settings.floor)
    window = point.settings.plan.window
    seen = np.array([sensor_noise(y[end - window : end]) for end in ends.tolist()])
    return np.maximum(np.where(np.isfinite(known), known, seen), point.settings.floor)


def _deviations(y: FloatArray, ends: NDArray[np.int64], window: int) -> FloatArray:
    """Return the standard deviation (N, p) of y (n, p) in windows that end before rows `ends` (N,)."""
    y = y - y.mean(axis=0)
    sums = np.vstack([np.zeros((1, y.shape[1])), np.cumsum(y, axis=0)])
    squares = np.vstack([np.zeros((1, y.shape[1])), np.cumsum(y**2, axis=0)])
    mean = (sums[ends] - sums[ends - window]) / window
    return np.sqrt(np.maximum((squares[ends] - squares[ends - window]) / window - mean**2, 0.0))
