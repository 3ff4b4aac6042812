"""Moving theta_r to a fit: the fit must pass the gate, then everything is built and summarised anew about it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.cells import Summary
from agent.numerics.colour import colour_of
from agent.numerics.fit import Fit
from agent.numerics.hops import Segment
from agent.numerics.reference import Reference, combined
from agent.numerics.window import solve_windows
from agent.numerics.working_point import WorkingPoint

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
    discrete = point.sampled(fit.theta)
    inputs = point.input_noise(discrete, point.settings.gains.settled(discrete, point.noise), len(fit.residual))
    point.colour = colour_of(fit.psi, fit.residual, fit.covariance, point.unknowns, inputs)
    if dof is None:
        return _place_long(point, segment, reference, fit, start)
    s2 = float(np.sum(fit.residual**2)) / dof
    variance = np.diag(fit.covariance) * max(s2, point.floor_ratio)
    if not (s2 <= point.gate and np.all(np.isfinite(variance))):
        return None
    scaled = fit.covariance / np.outer(point.scale, point.scale)
    information = np.asarray(np.linalg.pinv(scaled, hermitian=True), dtype=np.float64)
    total = _centre(point, segment, reference, fit.theta, information, start, fit.x0)
    return Placed(fit.theta, np.sqrt(variance) * point.widening, s2, total)


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


def _resummarise(point: WorkingPoint, segment: Segment, start: int, x0: FloatArray) -> Summary:
    """Run the operators over the window that starts at `start` with observer state x0 (n,); return its summary."""
    z = np.zeros(point.operators.nz)
    z[: point.n] = x0
    segment.restart(start, z)
    _, windows = segment.advance(point.operators, 1)
    if point.settings.plan.fulls:
        _, windows = segment.advance(point.operators, point.settings.plan.fulls)
    if windows is None:
        raise ValueError("a window needs all of its samples")
    return windows


def _place_long(point: WorkingPoint, segment: Segment, reference: Reference, fit: Fit, start: int) -> Placed | None:
    """Carry a fit of the newest samples to the whole window by steps on its summaries."""
    summaries = (segment.done, segment.z, segment.kept, segment.head)
    built = (point.operators, point.gain, point.discrete)
    point.theta, point.settled, x0 = fit.theta, True, np.zeros(point.n)
    for _ in range(STEPS):
        point.rebuild()
        solution = solve_windows(_resummarise(point, segment, start, x0), point.n)
        s2 = float(solution.residual[0]) / point.dof
        sd = np.sqrt(np.diag(solution.covariance[0]) * max(s2, point.floor_ratio))
        if not np.all(np.isfinite(sd)):
            break
        step = np.clip(solution.delta[0], -0.5 * point.scale, point.scale)
        x0 = x0 + solution.e0[0]
        if np.all(np.abs(step) < 0.1 * sd) and s2 <= point.gate:
            theta, information = point.theta + step, solution.information[0] * np.outer(point.scale, point.scale)
            total = _centre(point, segment, reference, theta, information, start, x0)
            return Placed(theta, sd * point.widening, s2, total)
        point.theta = np.maximum(point.theta + step, point.settings.lower)
    segment.done, segment.z, segment.kept, segment.head = summaries
    point.operators, point.gain, point.discrete = built
    return None
