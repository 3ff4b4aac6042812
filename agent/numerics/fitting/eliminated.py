"""What is eliminated from a window's columns: its initial state, and the readings that it lacks.

Of readings that lack only products with their responses are needed (`impulses`), so that the cost grows with the
window and, separately, with the cube of their number, but not with the window times the square of it.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.impulses import Impulses, Written
from agent.numerics.fitting.window_filter import WindowFilter, orthogonal
from agent.numerics.preprocessing.bridge import Bridge, Shrinkage, shrinkage

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TRACE = 1e-13
"""An unknown whose square outside of the initial state's directions is less than this share of it leaves no trace."""


@dataclass(frozen=True, slots=True)
class Solution:
    """What fits columns (W p, k) best.

    Attributes:
        rest: (W p, k) what no initial state explains of them.
        products: (c, k) U'rest.
        readings: (c, k) the readings that lack, off what was filled in.
        state: (n, k) the initial state beside those.
    """

    rest: FloatArray
    products: FloatArray
    readings: FloatArray
    state: FloatArray


@dataclass(frozen=True)
class Unknowns:
    """The unknowns of a window.

    Attributes:
        left: (W p, r) orthonormal basis of Gamma, what the initial state does.
        back: (n, r) with the pseudo-inverse of Gamma = back left'.
        out: (k,) rows that are left out.
        U: what the c readings that lack do; None where none does.
    """

    left: FloatArray
    back: FloatArray
    out: IntArray
    U: Impulses | Written | None

    @classmethod
    def of(cls, window: WindowFilter, bridge: Bridge | None) -> "Unknowns":
        """Return what a window of a filter does not know, where it lacks the readings of a bridge."""
        if bridge is None:
            return cls(*window.initial, np.zeros(0, dtype=np.int64), None)
        unknown, out = bridge.split(window.gain)
        responses = window.responses(unknown, out) if len(unknown.sample) else None
        return cls(*_without_rows(window, out), out, responses)

    def emptied(self, columns: FloatArray) -> FloatArray:
        """Return columns (W p, ..) without the rows that are left out; the same array where there are none."""
        if len(self.out):
            columns = columns.copy()
            columns[self.out] = 0.0
        return columns

    def solve(self, columns: FloatArray) -> Solution:
        """Fit columns (W p, k), emptied."""
        along = self.left.T @ columns
        rest = columns - self.left @ along
        if self.U is None:
            nothing = np.zeros((0, columns.shape[1]))
            return Solution(rest, nothing, nothing, self.back @ along)
        products = self.U.against(rest)
        readings = self._shrinkage.unknowns @ products
        return Solution(rest, products, readings, self.back @ (along - self._along.T @ readings))

    def completed(self, v: FloatArray, readings: FloatArray) -> FloatArray:
        """Return a window v (W, p+m) whose readings that lack are so far (c,) from where they were filled in."""
        if self.U is None:
            return v
        completed = v.copy()
        completed[self.U.unknown.sample, self.U.unknown.channel] -= readings
        return completed

    def left_of(self, solution: Solution) -> FloatArray:
        """Return what the unknowns leave of the columns (W p, k) of a solution."""
        if self.U is None:
            return solution.rest
        return np.asarray(solution.rest - self._beside(self._shrinkage.taken @ solution.products))

    def least_cost(self, e: FloatArray) -> float:
        """Return the sum of squares that the unknowns leave of e (W p,), emptied, what their priors cost included."""
        rest = e - self.left @ (self.left.T @ e)
        if self.U is None:
            return float(rest @ rest)
        weight = 1.0 / self.U.unknown.sd
        precision = self._gram + np.diag(weight**2)
        scale = np.sqrt(np.maximum(np.diag(precision), 1e-300))
        # evaluated where it is least, so an error of the readings counts by its square only
        scaled = precision / np.outer(scale, scale) + TRACE * np.eye(len(scale))
        readings = np.linalg.solve(scaled, self.U.against(rest[:, None])[:, 0] / scale) / scale
        rest = rest - self._beside(readings[:, None])[:, 0]
        return float(rest @ rest + np.sum((weight * readings) ** 2))

    def _beside(self, readings: FloatArray) -> FloatArray:
        """Return what readings (c, k) do that no initial state does, (W p, k)."""
        if self.U is None:
            return np.zeros((len(self.left), readings.shape[1]))
        return np.asarray(self.U.times(readings) - self.left @ (self._along.T @ readings))

    @cached_property
    def _along(self) -> FloatArray:
        """U'left (c, r)."""
        return np.zeros((0, self.left.shape[1])) if self.U is None else self.U.against(self.left)

    @cached_property
    def _gram(self) -> FloatArray:
        """U'U (c, c), free of what the initial state does."""
        if self.U is None:
            return np.zeros((0, 0))
        whole = self.U.gram()
        gram = whole - self._along @ self._along.T
        traceless = np.diag(gram) <= TRACE * np.diag(whole)
        gram[traceless] = gram[:, traceless] = 0.0
        return np.asarray(gram)

    @cached_property
    def _shrinkage(self) -> Shrinkage:
        return shrinkage(self._gram, np.zeros(0) if self.U is None else self.U.unknown.sd)


def _without_rows(window: WindowFilter, out: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return basis and way back of a window's Gamma with some rows emptied."""
    left, back = window.initial
    if not len(out):
        return left, back
    gone = left[out]
    values, turn = np.linalg.eigh(np.eye(left.shape[1]) - gone.T @ gone)
    if values.min(initial=1.0) < 0.5:  # the rows weigh much: from the beginning, on samples
        Gamma = window.G[:, : window.system.n].copy()
        Gamma[out] = 0.0
        return orthogonal(Gamma)
    root = turn / np.sqrt(values)
    kept = left @ root
    kept[out] = 0.0
    return kept, back @ root
