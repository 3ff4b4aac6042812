"""Several windows at once: each estimate is taken from the shortest window that knows it well enough."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.cells import Summary
from agent.numerics.rows import Rows
from agent.numerics.window import solve_windows

FloatArray = NDArray[np.float64]
SURE = 4.0
"""Standard deviations that are no chance: once in 32,000 windows."""
FEWEST = 6.0
"""Degrees of freedom below which the approximation of F has no such point."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """What one longer window says at the newest N of a batch of rows.

    Attributes:
        window: its length, samples.
        dof: degrees of freedom of its residual variance.
        theta, sd: (N, q) estimates and their sd under white noise.
        ratio: (N,) residual variance over the reference.
    """

    window: int
    dof: float
    theta: FloatArray
    sd: FloatArray
    ratio: FloatArray


def candidate(summary: Summary, window: int, theta_r: FloatArray, n: int, outputs: int, least: float) -> Candidate:
    """Solve the windows of one length; theta_r (q,) is where they were linearised, least the smallest variance."""
    solution = solve_windows(summary, n)
    dof = max(float(window * outputs - n - len(theta_r)), 1.0)
    ratio = solution.residual / dof
    variance = np.einsum("nii->ni", solution.covariance) * np.maximum(ratio, least)[:, None]
    return Candidate(window, dof, theta_r + solution.delta, np.sqrt(variance), ratio)


def gate(dof: float, doubt: float, share: FloatArray | float = 1.0) -> FloatArray:
    """Largest residual variance, in units of the reference, of an undisturbed window with dof degrees of freedom.

    The four-sigma point of the chi-square distribution over its degrees of freedom, by the cube root that is nearly
    normal (Wilson & Hilferty 1931); where doubt is 2, the reference was learnt from a window as uncertain as what it is
    compared with and the point is that of F (Paulson 1942). share is what colour leaves of dof, 1 for white noise.
    """
    spread = 2.0 / (9.0 * np.maximum(dof * np.asarray(share), FEWEST))
    if doubt == 1.0:
        return np.asarray((1.0 - spread + SURE * np.sqrt(spread)) ** 3)
    middle, width = (1.0 - spread) ** 2, SURE**2 * spread
    return np.asarray(((middle + np.sqrt(width * (2.0 * middle - width))) / (middle - width)) ** 3)


def keep_each(
    rows: Rows, widening: FloatArray, share: FloatArray, found: Sequence[Candidate], longer: Sequence[int], doubt: float
) -> None:
    """Note in rows what each window says, before one is chosen; longer names all further windows, samples.

    Other arguments: see `choose`.
    """
    rows.each_theta[:, 0], rows.each_sd[:, 0], rows.each_dof[:, 0] = rows.theta, rows.sd, rows.dof
    rows.each_fits[:, 0] = rows.full & ~rows.changing & ~rows.mismatch
    for told in found:
        place, new = 1 + list(longer).index(told.window), slice(len(rows.index) - len(told.ratio), None)
        rows.each_theta[new, place], rows.each_sd[new, place] = told.theta, told.sd * widening[new]
        rows.each_dof[new, place] = told.dof * share[new]
        rows.each_fits[new, place] = told.ratio <= gate(told.dof, doubt, share[new])


def choose(
    rows: Rows, widening: FloatArray, share: FloatArray, found: Sequence[Candidate], wanted_sd: FloatArray, doubt: float
) -> None:
    """Replace estimates of rows in place by those of longer windows where the shorter ones are not sure enough.

    Args:
        rows: judged rows of the shortest window, its length filled in.
        widening: (N, q) honest sd over the white one.
        share: (N,) effective degrees of freedom over their count.
        found: longer windows, shortest first, for the newest of these rows.
        wanted_sd: (q,) an estimate this sure needs no longer window; the longest undisturbed one serves where none is.
        doubt: see `gate`.
    """
    usable = rows.full & ~rows.changing & ~rows.mismatch
    for longer in found:
        new = slice(len(rows.index) - len(longer.ratio), None)
        passes = usable[new] & (longer.ratio <= gate(longer.dof, doubt, share[new]))
        take = passes[:, None] & ~(rows.sd[new] <= wanted_sd) & np.isfinite(longer.sd)
        rows.theta[new] = np.where(take, longer.theta, rows.theta[new])
        rows.sd[new] = np.where(take, longer.sd * widening[new], rows.sd[new])
        rows.window[new] = np.where(take, longer.window, rows.window[new])
