"""Moving theta_r to a fit: the fit must pass the gate, then everything is built and summarised anew about it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.fitting.colour import colour_of
from agent.numerics.fitting.fit import Fit
from agent.numerics.window.cells import Summary
from agent.numerics.window.hops import Segment
from agent.numerics.window.reference import Reference, combined
from agent.numerics.window.solution import solve_windows

FloatArray = NDArray[np.float64]
STEPS = 8
"""Steps on the summaries of a long window before its fit counts as failed."""


@dataclass(frozen=True, slots=True)
class Placed:
    """What a window says whose fit moved theta_r.

    Attributes:
        theta, sd: (q,) its own estimates; theta_r lies between them and the reference.
        ratio: its residual variance over the reference's.
        reference: what all windows say now.
    """

    theta: FloatArray
    sd: FloatArray
    ratio: float
    reference: Reference


def place(
    point: WorkingPoint, segment: Segment, reference: Reference, fit: Fit, start: int, dof: float | None
) -> Placed | None:
    """Linearise about the fit of the window from sample `start` if it passes the gate; None where it does not.

    dof are the fit's degrees of freedom, None where only a part of a long window was fitted.
    """
    if not np.all(np.isfinite(fit.covariance)):
        return None
    v = segment.samples(start, start + point.settings.plan.window)[-len(fit.residual) :]
    point.learn_jitter(fit.residual, v)
    _colour(point, fit, v)
    if dof is None:
        return _place_long(point, segment, reference, fit, start)
    s2 = float(np.sum(fit.residual**2)) / dof
    variance = np.diag(fit.covariance) * max(s2, point.floor_ratio)
    ratio = _ratio(point, segment, start, point.settings.plan.window, s2)
    if not (ratio <= point.gate and np.all(np.isfinite(variance))):
        return None
    scaled = fit.covariance / np.outer(point.scale, point.scale)
    information = np.asarray(np.linalg.pinv(scaled, hermitian=True), dtype=np.float64)
    total = _centre(point, segment, reference, fit.theta, information, start, fit.x0)
    return Placed(fit.theta, np.sqrt(variance) * point.widening, ratio, total)


def _colour(point: WorkingPoint, fit: Fit, v: FloatArray) -> None:
    """Take the colour of a fit of samples v (W, p+m)."""
    discrete = point.sampled(fit.theta)
    inputs = point.input_noise(discrete, point.settings.gains.settled(discrete, point.noise), len(fit.residual))
    varying = point.varying(fit.residual, v)
    point.colour = colour_of(fit.psi, fit.residual, fit.covariance, point.unknowns, inputs, varying)


def _ratio(point: WorkingPoint, segment: Segment, start: int, window: int, s2: float) -> float:
    """Return the residual variance s2 of `window` samples from `start` on over what their speed leads to expect."""
    return float(point.ratio(np.array([s2]), segment, np.array([start + window - 1]), window)[0])


def _centre(
    point: WorkingPoint, segment: Segment, reference: Reference, theta: FloatArray, information: FloatArray,
    start: int, x0: FloatArray,
) -> Reference:  # fmt: skip
    """Move theta_r to what window and reference say together, summarise the window anew, return the new reference."""
    centre, total = combined(reference, information, theta / point.scale)
    point.theta = np.maximum(centre * point.scale, point.settings.lower)
    point.settled = True
    point.rebuild()
    _resummarise(point, segment, start, x0)
    return total


def _resummarise(
    point: WorkingPoint, segment: Segment, start: int, x0: FloatArray, longer: int | None = None
) -> Summary:
    """Run the operators over the window that starts at `start` with observer state x0 (n,); return its summary.

    longer: number of the longer window that it is; None for the plan's own.
    """
    z = np.zeros(point.operators.nz)
    z[: point.n] = x0
    segment.restart(start, z)
    _, windows = segment.advance(point.operators, 1)
    fulls = point.settings.plan.fulls if longer is None else segment.more[longer]
    if fulls:
        _, windows = segment.advance(point.operators, fulls)
    if longer is not None:
        windows = segment.longer[longer]
    if windows is None:
        raise ValueError("a window needs all of its samples")
    return windows


def _place_long(point: WorkingPoint, segment: Segment, reference: Reference, fit: Fit, start: int) -> Placed | None:
    """Carry a fit of the newest samples to the whole window by steps on its summaries."""
    found = _carry(point, segment, (fit.theta, np.zeros(point.n)), start)
    if found is None:
        return None
    theta, information = found.theta, found.information
    total = _centre(point, segment, reference, theta, information, start, found.x0)
    return Placed(theta, found.sd * point.widening, found.ratio, total)


@dataclass(frozen=True, slots=True)
class _Carried:
    """A maximum found on summaries: theta, white sd (q,), scaled information (q, q), x0 (n,), the residual's ratio."""

    theta: FloatArray
    sd: FloatArray
    information: FloatArray
    x0: FloatArray
    ratio: float


def _carry(
    point: WorkingPoint, segment: Segment, begin: tuple[FloatArray, FloatArray], start: int, longer: int | None = None
) -> _Carried | None:
    """Step from theta (q,) and x0 (n,) to the maximum of the window from sample `start`, on its summaries.

    Returns None, and leaves everything as it was, where that does not converge or pass the gate.
    """
    restore, built = segment.kept_summaries(), (point.operators, point.gain, point.discrete, point.theta, point.settled)
    window = point.settings.plan.window if longer is None else point.settings.longer[longer]
    dof, highest = point.dof_of(window), point.gate_of(window)
    point.theta, point.settled, x0 = begin[0], True, begin[1]
    for _ in range(STEPS):
        point.rebuild()
        windows = _resummarise(point, segment, start, x0, longer)
        solution = solve_windows(windows.part(slice(-1, None)), point.n)
        s2 = float(solution.residual[0]) / dof
        sd = np.sqrt(np.diag(solution.covariance[0]) * max(s2, point.floor_ratio))
        if not np.all(np.isfinite(sd)):
            break
        step = np.clip(solution.delta[0], -0.5 * point.scale, point.scale)
        x0 = x0 + solution.e0[0]
        ratio = _ratio(point, segment, start, window, s2)
        if np.all(np.abs(step) < 0.1 * sd) and ratio <= highest:
            information = solution.information[0] * np.outer(point.scale, point.scale)
            return _Carried(point.theta + step, sd, information, x0, ratio)
        point.theta = np.maximum(point.theta + step, point.settings.lower)
    restore()
    point.operators, point.gain, point.discrete, point.theta, point.settled = built
    return None


def place_longer(
    point: WorkingPoint, segment: Segment, fit: Fit, stop: int, longer: int, *, whole: bool
) -> Reference | None:
    """Linearise about what the longer window of that number says which ends before sample `stop`; None where it fails.

    fit: of its newest samples, or of the whole. What it says alone is the new reference: the windows that the old one
    was made of are in it, less well linearised.
    """
    if not np.all(np.isfinite(fit.theta)):
        return None
    start = stop - point.settings.longer[longer]
    found = _carry(point, segment, (fit.theta, fit.x0 if whole else np.zeros(point.n)), start, longer)
    if found is None:
        return None
    point.theta = np.maximum(found.theta, point.settings.lower)
    point.rebuild()
    _resummarise(point, segment, start, found.x0, longer)
    return Reference(found.information, found.information @ (point.theta / point.scale))
