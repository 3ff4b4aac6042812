"""Solved windows as rows: estimates and their sd, before any verdict."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.lacking import MOST, Answer, Lacking, answer
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.fitting.fit import linearised
from agent.numerics.window.choice import Asked, Candidate, candidate
from agent.numerics.window.hops import Segment
from agent.numerics.window.reach import strain
from agent.numerics.window.rows import Rows
from agent.numerics.window.solution import WindowSolution

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Solved:
    """Rows with what else their windows say.

    Attributes:
        rows: N rows without verdicts.
        information: (N, q, q) of their windows, in units of the parameters' sizes.
        candidates: what longer windows say at the newest of them.
    """

    rows: Rows
    information: FloatArray
    candidates: list[Candidate]


def solved(point: WorkingPoint, segment: Segment, index: IntArray, solution: WindowSolution | None) -> Solved:
    """Return rows at sample numbers index (N,); the newest of them have the solved windows, if there are any."""
    q = len(point.theta)
    rows = Rows.warming(index, q, point.settings.windows)
    information = np.zeros((len(index), q, q))
    if solution is None:
        return Solved(rows, information, [])
    s2 = solution.residual / point.dof
    # a residual of exactly nothing leaves what is unknown unknown
    s2_floored = np.maximum(s2, max(point.floor_ratio, 1e-300))
    variance = np.einsum("nii->ni", solution.covariance) * s2_floored[:, None]
    new = slice(len(index) - len(s2), None)
    rows.theta[new] = point.theta + solution.delta
    rows.sd[new] = np.sqrt(variance) * point.widening
    rows.dof[new], rows.full[new] = point.dof * point.colour.share, True
    rows.ratio[new] = point.ratio(s2, segment, index[new], point.settings.plan.window)
    rows.window[new] = point.settings.plan.window
    information[new] = solution.information * np.outer(point.scale, point.scale)
    return Solved(rows, information, _candidates(point, segment, index))


def _candidates(point: WorkingPoint, segment: Segment, index: IntArray) -> list[Candidate]:
    """What the longer windows that are whole say at the newest of the rows index (N,)."""
    asked = [Asked(w, point.theta, turn) for w, turn in zip(point.settings.longer, point.turns, strict=True)]
    pairs, least = zip(asked, segment.longer, strict=True), point.floor_ratio
    found = [candidate(s, one, point.n, point.outputs, least) for one, s in pairs if s is not None]
    for told in found:
        told.ratio[:] = point.ratio(told.ratio, segment, index[len(index) - len(told.ratio) :], told.window)
    return found


def mend(found: Solved, point: WorkingPoint, segment: Segment, lacking: Lacking) -> None:
    """Solve the windows that lack readings once more, with those as unknowns, and put that in place.

    Inputs in doubt are taken for spikes where a window fits without them and not with them.
    """
    if not lacking.any():
        return
    rows, window, gate = found.rows, point.settings.plan.window, point.gate
    counts = lacking.count(rows.index, window)
    for row in np.flatnonzero(rows.full).tolist():
        stop = int(rows.index[row]) + 1
        if counts[row]:
            _put(found, point, segment, row, _on_samples(point, segment, lacking, stop, window))
        if not rows.ratio[row] <= gate and lacking.doubts(stop, window):
            lacking.take_for_spikes(stop, window)
            told = _on_samples(point, segment, lacking, stop, window)
            if _judged(point, segment, stop, told, window)[1] <= gate:
                _put(found, point, segment, row, told)
                counts = lacking.count(rows.index, window)
            else:
                lacking.take_back(stop - 2)
    for longer in found.candidates:
        newest = rows.index[len(rows.index) - len(longer.ratio) :]
        for i in np.flatnonzero(lacking.count(newest, longer.window) > 0).tolist():
            stop = int(newest[i]) + 1
            told = _on_samples(point, segment, lacking, stop, longer.window)
            _, longer.ratio[i], longer.sd[i] = _judged(point, segment, stop, told, longer.window)
            longer.theta[i] = point.theta + told.delta
            turn = point.turns[point.settings.longer.index(longer.window)]
            longer.weight[i] = told.delta @ told.information @ told.delta
            longer.strain[i] = strain(turn, told.delta, longer.weight[i])


def _put(found: Solved, point: WorkingPoint, segment: Segment, row: int, told: Answer) -> None:
    """Put an answer in the place of a row."""
    rows, window = found.rows, point.settings.plan.window
    dof, rows.ratio[row], sd = _judged(point, segment, int(rows.index[row]) + 1, told, window)
    rows.theta[row], rows.sd[row] = point.theta + told.delta, sd * point.widening
    rows.dof[row] = dof * point.colour.share
    found.information[row] = told.information * np.outer(point.scale, point.scale)


def _on_samples(point: WorkingPoint, segment: Segment, lacking: Lacking, stop: int, window: int) -> Answer:
    """Solve one window that ends before sample `stop` about theta_r, on its samples."""
    v, q = segment.samples(stop - window, stop), len(point.theta)
    if lacking.count(np.array([stop - 1]), window)[0] > MOST * window:
        return Answer(np.full(q, np.nan), np.full((q, q), np.inf), np.zeros((q, q)), np.inf, 0)
    bridge = lacking.bridge(v, stop)
    here = linearised(point.filter(window), v, np.zeros(point.n), bridge)
    return answer(here, 0 if bridge is None else bridge.free)


def _judged(
    point: WorkingPoint, segment: Segment, stop: int, found: Answer, window: int
) -> tuple[float, float, FloatArray]:
    """Return degrees of freedom, residual variance over what is expected, and white sd (q,) of an answer."""
    dof = point.dof_of(window, found.free)
    ratio = found.residual / dof
    variance = np.diag(found.covariance) * max(ratio, point.floor_ratio, 1e-300)
    explained = point.ratio(np.array([ratio]), segment, np.array([stop - 1]), window)
    return dof, float(explained[0]), np.sqrt(variance)
