"""Parameters on the move: where constants stop telling a window, a straight line for each may tell a longer one.

Lines are tried from a row on that moved theta_r or that no constant explains, for as long as they find movement; a rig
at rest never pays for them. A window of constants lags half its length behind a drift; a line does not lag, and the
longer window pays for its second unknown many times over.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.lacking import Lacking
from agent.numerics.estimator.upkeep import NEVER
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.fitting.colour import colour_of
from agent.numerics.fitting.line import Line, fit_line
from agent.numerics.window.choice import gate
from agent.numerics.window.hops import Segment
from agent.numerics.window.rows import Rows

FloatArray = NDArray[np.float64]
SURE = 4.0
"""Standard deviations of a slope that are movement, not chance."""


class Moving:
    """Straight lines over windows of `window` samples; one object follows one stream."""

    def __init__(self, window: int) -> None:
        self.window = window
        self._until = NEVER
        self._line: Line | None = None

    def forget(self) -> None:
        """Begin after a gap."""
        self._until, self._line = NEVER, None

    def follow(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, *, moved: bool) -> None:
        """Put lines in place of constants in settled rows where the parameters move; moved: theta_r, at the last."""
        stirred = (rows.changing | rows.mismatch) & rows.full
        if moved:
            stirred[-1] = True
        first = np.flatnonzero(stirred | (rows.index < self._until))
        for row in range(int(first[0]) if len(first) else len(stirred), len(stirred)):
            index = int(rows.index[row])
            if stirred[row]:
                self._until = index + self.window
            # each line that tells a row keeps the search up, so which rows are tried is known only one after the other
            if index < self._until and self._is_told(point, segment, lacking, rows, row):
                self._until = index + self.window

    def _is_told(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int) -> bool:
        """Fit a line to the window of a row; give the row what it says if it stands and moves."""
        stop = int(rows.index[row]) + 1
        if not rows.full[row] or stop - self.window < segment.first:
            return False
        if lacking.count(rows.index[row : row + 1], self.window)[0]:
            return False
        near = np.where(np.isfinite(rows.theta[row]), rows.theta[row], point.theta)
        theta, slope = (near, np.zeros_like(near)) if self._line is None else (self._line.theta, self._line.slope)
        problem = point.problem(segment.samples(stop - self.window, stop), None)
        line = fit_line(problem, point.gain, theta, slope)
        judged = None if line is None else _judge(point, line, self.window)
        if line is None or judged is None:
            self._line = None
            return False
        self._line = line
        q = len(theta)
        moving = (np.abs(line.slope) > SURE * judged.sd[q:]) & (np.abs(line.slope) > point.negligible)
        if not np.any(moving):
            return False
        rows.theta[row], rows.sd[row], rows.ratio[row] = line.theta, judged.sd[:q], judged.ratio
        rows.dof[row], rows.window[row] = judged.dof, self.window
        rows.changing[row] = rows.mismatch[row] = False
        rows.suspect[row], rows.channel[row] = 0, -1
        return True


@dataclass(frozen=True, slots=True)
class _Judged:
    """What a line that stands is worth: sd (2q,) of values and slopes, residual variance, degrees of freedom."""

    sd: FloatArray
    ratio: float
    dof: float


def _judge(point: WorkingPoint, line: Line, window: int) -> _Judged | None:
    """Return what a line is worth, None where its residual is too large."""
    q = len(line.theta)
    inputs = point.input_noise(point.discrete, point.gain, window)
    colour = colour_of(line.psi, line.residual, line.covariance, point.unknowns + q, inputs)
    dof = point.dof_of(window, q)
    ratio = float(np.sum(line.residual**2)) / dof
    if ratio > gate(dof, point.doubt, colour.share):
        return None
    white = np.sqrt(np.diag(line.covariance) * max(ratio, point.floor_ratio))
    return _Judged(white * colour.inflation * np.tile(point.commission.factor, 2), ratio, dof * colour.share)
