"""What the rig was until a window ago: an estimate that contradicts it comes from a window that may hold a change.

A window that straddles a step can leave a residual no larger than noise while its estimates are bent by many of their
sd (a step of one spring by 15 % moved a damper by 35 %, the residual by 5 %). No test on that window alone can tell,
but the windows before it can: where an estimate leaves them, the change may lie inside, and only a window that begins
after the first such estimate is clean for certain. The past compared with shares no sample with the window.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.window.reference import Reference, mean_and_sd

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
SURE = 4.0
"""Standard deviations between an estimate and the past that are no chance: once in 16,000 rows."""


@dataclass(frozen=True, slots=True)
class Past:
    """Disjoint healthy windows in units of the parameters' sizes.

    Attributes:
        reference: all of them but the newest, with slow forgetting.
        newest: information (q, q) and theta (q,) of the newest, which the windows now coming still overlap.
    """

    reference: Reference
    newest: tuple[FloatArray, FloatArray] | None = None

    @classmethod
    def empty(cls, q: int) -> "Past":
        """Return no past."""
        return cls(Reference.empty(q))

    def mean(self) -> FloatArray | None:
        """Return theta (q,) of all but the newest window; None where some parameter is unknown."""
        mean, sd = mean_and_sd(self.reference.A[None], self.reference.b[None])
        return mean[0] if np.all(np.isfinite(sd)) else None

    def after(self, information: FloatArray, theta: FloatArray) -> "Past":
        """Return the past after N > 0 further disjoint windows, information (N, q, q), theta (N, q)."""
        A, b = self._references(information, theta)
        return Past(Reference(A[-2], b[-2]), (information[-1], theta[-1]))

    def _references(self, information: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return A (N+1 or N+2, q, q), b: of all but the newest, with it where there is one, with each of N more."""
        if self.newest is not None:
            information = np.concatenate([self.newest[0][None], information])
            theta = np.concatenate([self.newest[1][None], theta])
        if not len(theta):
            return self.reference.A[None], self.reference.b[None]
        A, b = self.reference.with_windows(information, theta)
        return np.concatenate([self.reference.A[None], A]), np.concatenate([self.reference.b[None], b])

    def contradicted(
        self, rows: tuple[FloatArray, FloatArray], chosen: IntArray, information: FloatArray, widening: FloatArray,
        matters: FloatArray,
    ) -> BoolArray:  # fmt: skip
        """Return which of N rows (theta, sd (N, q)) leave what was known before their windows began.

        Args:
            rows: estimates and their honest sd.
            chosen: the disjoint healthy rows among them.
            information: (N, q, q) of all rows.
            widening: (q,) honest sd over the white one.
            matters: (q,) smaller differences are of no concern.
        """
        theta, sd = rows
        A, b = self._references(information[chosen], theta[chosen])
        # the window of a chosen row is known to those that begin after it: from the next chosen row on
        known = np.searchsorted(chosen, np.arange(len(theta)), side="right")
        known = known if self.newest is not None else np.maximum(known - 1, 0)
        used = slice(0, int(known.max(initial=0)) + 1)
        mean, spread = mean_and_sd(A[used], b[used])
        with np.errstate(invalid="ignore"):
            difference = np.abs(theta - mean[known])
            sure = difference > SURE * np.hypot(sd, spread[known] * widening)
        return np.asarray(np.any(sure & (difference > matters) & (sd < matters), axis=1))
