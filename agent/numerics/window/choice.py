"""Several windows at once: each estimate is taken from the shortest window that knows it well enough."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.window.cells import Summary
from agent.numerics.window.reach import STRAIN, strain
from agent.numerics.window.rows import Rows
from agent.numerics.window.solution import solve_windows

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
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
        weight: (N,) how surely they differ from theta_r, and
        strain: (N,) what a linear step over that distance leaves out, in sd (`reach`).
    """

    window: int
    dof: float
    theta: FloatArray
    sd: FloatArray
    ratio: FloatArray
    weight: FloatArray
    strain: FloatArray

    @property
    def near(self) -> BoolArray:
        """(N,) windows that are so near theta_r that their one linear step is right."""
        return np.asarray(self.strain <= STRAIN)

    def fits(self, doubt: float, share: FloatArray) -> BoolArray:
        """(N,) windows that hold no disturbance and are near enough; share (N,) and doubt as of `gate`."""
        return np.asarray((self.ratio <= gate(self.dof, doubt, share)) & self.near)


@dataclass(frozen=True, slots=True)
class Asked:
    """Of one longer window: its length in samples, theta_r (q,), and how far modes turn in it (q,) (`reach.turns`)."""

    window: int
    theta_r: FloatArray
    turn: FloatArray


def candidate(summary: Summary, asked: Asked, n: int, outputs: int, least: float) -> Candidate:
    """Solve the windows of one length; least is the smallest variance."""
    solution, theta_r = solve_windows(summary, n), asked.theta_r
    dof = max(float(asked.window * outputs - n - len(theta_r)), 1.0)
    ratio = solution.residual / dof
    variance = np.einsum("nii->ni", solution.covariance) * np.maximum(ratio, least)[:, None]
    strained = strain(asked.turn, solution.delta, solution.explained)
    theta, sd = theta_r + solution.delta, np.sqrt(variance)
    return Candidate(asked.window, dof, theta, sd, ratio, solution.explained, strained)


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

    share (N,) is effective degrees of freedom over their count, doubt as of `gate`; other arguments: see `choose`.
    """
    rows.each_theta[:, 0], rows.each_sd[:, 0], rows.each_dof[:, 0] = rows.theta, rows.sd, rows.dof
    rows.each_fits[:, 0] = rows.full & ~rows.changing & ~rows.mismatch
    for told in found:
        place, new = 1 + list(longer).index(told.window), slice(len(rows.index) - len(told.ratio), None)
        rows.each_theta[new, place], rows.each_sd[new, place] = told.theta, told.sd * widening[new]
        rows.each_dof[new, place] = told.dof * share[new]
        rows.each_fits[new, place] = told.fits(doubt, share[new])


def choose(
    rows: Rows, widening: FloatArray, found: Sequence[Candidate], longer: Sequence[int], wanted_sd: FloatArray
) -> None:
    """Replace estimates of rows in place by those of longer windows where the shorter ones are not sure enough.

    Args:
        rows: judged rows of the shortest window, its length filled in, with what each window says (`keep_each`).
        widening: (N, q) honest sd over the white one.
        found: longer windows, shortest first, for the newest of these rows.
        longer: all further windows, samples.
        wanted_sd: (q,) an estimate this sure needs no longer window; the longest undisturbed one serves where none is.
    """
    usable = rows.full & ~rows.changing & ~rows.mismatch
    for told in found:
        new = slice(len(rows.index) - len(told.ratio), None)
        passes = usable[new] & rows.each_fits[new, 1 + list(longer).index(told.window)]
        take = passes[:, None] & ~(rows.sd[new] <= wanted_sd) & np.isfinite(told.sd)
        rows.theta[new] = np.where(take, told.theta, rows.theta[new])
        rows.sd[new] = np.where(take, told.sd * widening[new], rows.sd[new])
        rows.window[new] = np.where(take, told.window, rows.window[new])
