"""Several windows: theta_r is moved to where the longest undisturbed one says that it is.

theta_r of the shortest window may be too far off for the one linear step of a longer one (`reach`), which then is none
to choose from. Where it is sure of another place it is fitted, and rows go on from there, with all shorter windows:
those are in it. A window that holds a change fits nowhere: only what began after it is tried, and ever more seldom.
"""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.lacking import MOST, Lacking
from agent.numerics.estimator.placing import place_longer
from agent.numerics.estimator.solved import Solved
from agent.numerics.estimator.upkeep import NEVER
from agent.numerics.estimator.window_settings import WindowSettings
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.window.choice import Candidate
from agent.numerics.window.hops import Segment
from agent.numerics.window.reference import Reference

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
LONG = 4096
"""Samples beyond which a fit begins with the newest of a window, and ends on summaries."""
MOST_FAILED = 6
"""Fits that fail are tried again after a quarter of the window, then after twice as long each time, this often."""
NONE = -1


class Farther:
    """Follows the longer windows of an estimator."""

    def __init__(self, settings: WindowSettings) -> None:
        self._longer = settings.longer
        self._tried = [NEVER] * len(self._longer)
        self._failed = [0] * len(self._longer)

    def asks(self, point: WorkingPoint, found: Solved) -> IntArray:
        """Return the number of the longer window that each row (N,) asks to fit; NONE where it asks for none.

        The longest speaks first; one that fits where theta_r is leaves no word to the shorter.
        """
        rows, count = found.rows, len(found.rows.index)
        asks, open_ = np.full(count, NONE), np.ones(count, dtype=bool)
        if all(told.near.all() for told in found.candidates):
            return asks
        for told in reversed(found.candidates):
            number, new = self._longer.index(told.window), slice(count - len(told.ratio), None)
            due = rows.index[new] - self._tried[number] >= (told.window // 4) << self._failed[number]
            asking = open_[new] & due & _sure(point, told)
            asks[new][asking] = number
            open_[new] &= ~asking & ~told.fits(point.doubt, rows.dof[new] / point.dof)
        return asks

    def move(
        self, point: WorkingPoint, segment: Segment, lacking: Lacking, index: int, number: int
    ) -> Reference | None:
        """Fit a longer window whose newest sample is `index`; return the new reference where theta_r was moved."""
        window, stop = self._longer[number], index + 1
        self._tried[number] = index
        lacks = int(lacking.count(np.array([index]), window)[0])
        if lacks > MOST * window:
            return None
        whole = window <= LONG
        v = segment.samples(stop - (window if whole else LONG), stop)
        restore = point.kept()
        problem = point.problem(v, lacking.bridge(v, stop))
        fit = point.maximise(problem, point.theta, afresh=False, near=False)
        moved = place_longer(point, segment, fit, stop, number, whole=whole) if fit.converged else None
        self._failed[number] = 0 if moved is not None else min(self._failed[number] + 1, MOST_FAILED)
        if moved is None:
            restore()
        return moved


def _sure(point: WorkingPoint, told: Candidate) -> BoolArray:
    """(N,) windows that are too far from theta_r, beyond chance, and know something."""
    q = told.theta.shape[1]
    known = np.any(told.sd < point.settings.enough_sd, axis=1)
    return np.asarray(known & ~told.near & (told.weight > q + 5.0 * np.sqrt(2.0 * q)))
