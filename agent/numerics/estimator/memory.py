"""What undisturbed windows have said so far, and which rows leave it.

Two memories: the reference is all windows up to now and says where to linearise; the past ends where the windows now
coming begin and says whether they contradict it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.window.hops import HopPlan
from agent.numerics.window.past import Past
from agent.numerics.window.reference import Reference, mean_and_sd
from agent.numerics.window.rows import Rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
FAR = 6.0
"""Standard deviations from theta_r at which an estimate is elsewhere for certain."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Disjoint healthy windows since the last change, in units of the parameters' sizes."""

    reference: Reference
    past: Past

    @classmethod
    def empty(cls, q: int) -> "Memory":
        """Return the memory of nothing."""
        return cls(Reference.empty(q), Past.empty(q))

    def with_rows(self, point: WorkingPoint, rows: Rows, information: FloatArray, chosen: IntArray) -> "Memory":
        """Return the memory after some rows, one or more, whose windows are healthy and disjoint."""
        theta = rows.theta[chosen] / point.scale
        A, b = self.reference.with_windows(information[chosen], theta)
        return Memory(Reference(A[-1], b[-1]), self.past.after(information[chosen], theta))

    def with_reference(self, reference: Reference) -> "Memory":
        """Return the same past with another reference."""
        return replace(self, reference=reference)

    def without_past(self) -> "Memory":
        """Return the same reference without a past: what came before is not what is now."""
        return replace(self, past=Past.empty(len(self.reference.b)))

    def contradicted(self, point: WorkingPoint, rows: Rows, information: FloatArray, passes: BoolArray) -> BoolArray:
        """(N,) some estimate leaves what was known before its window began, beyond chance and enough to matter.

        passes (N,): rows whose residual is no larger than it may be.
        """
        estimates = (rows.theta / point.scale, rows.sd / point.scale)
        matters = point.settings.enough_sd / point.scale
        chosen = disjoint(point.settings.plan, rows, passes)
        while True:
            found = self.past.contradicted(estimates, chosen, information, point.widening, matters)
            wrong = chosen[found[chosen]]
            if not len(wrong):
                return found
            # a contradicted row is not remembered, so it must not speak for those after it either
            chosen = chosen[chosen != wrong[0]]

    def drifted(self, point: WorkingPoint, rows: Rows, information: FloatArray, healthy: BoolArray) -> BoolArray:
        """(N,) the windows up to a row, together, put theta away from theta_r."""
        drifted = np.zeros(len(rows.index), dtype=bool)
        chosen = disjoint(point.settings.plan, rows, healthy)
        if len(chosen):
            A, b = self.reference.with_windows(information[chosen], rows.theta[chosen] / point.scale)
            mean, sd = mean_and_sd(A, b)
            change = np.abs(mean * point.scale - point.theta)
            known = sd * point.scale < point.settings.enough_sd
            beyond = (change > 3 * sd * point.scale) & (change > point.negligible)
            drifted[chosen] = np.any(known & beyond, axis=1)
        return drifted


def disjoint(plan: HopPlan, rows: Rows, healthy: BoolArray) -> IntArray:
    """Return which healthy rows have windows that follow each other without overlap: one in ceil(W/H)."""
    number = rows.index // plan.hop
    chosen = number % (plan.fulls + 1) == 0
    return np.flatnonzero(chosen & healthy & rows.full & np.isfinite(rows.theta).all(axis=1))


def far(point: WorkingPoint, rows: Rows) -> BoolArray:
    """(N,) some estimate is so far from theta_r, and so surely, that the linearisation should move at once."""
    change = np.abs(rows.theta - point.theta)
    known = rows.sd < point.settings.enough_sd
    return np.asarray(np.any(known & (change > FAR * rows.sd) & (change > point.negligible), axis=1))


def quieter(point: WorkingPoint, rows: Rows) -> BoolArray:
    """(N,) the residual is so far below a learnt reference that the reference was learnt in a disturbance."""
    return np.asarray(point.calibrator.learns & (rows.ratio < 2.0 - point.gate))
