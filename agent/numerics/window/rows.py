"""What an estimation method gives: rows of estimates, one a hop."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Rows:
    """Estimates at N hops.

    Attributes:
        index: (N,) newest sample of each window, counted from the run's first.
        theta, sd: (N, q); NaN while warming.
        dof: (N,) degrees of freedom of the residual variance.
        full: (N,) a whole window was there.
        changing, mismatch: (N,) the window is not to be believed: since less than a window's length, or for longer.
        ratio: (N,) residual variance over the reference.
        suspect: (N,) the Reason that a model which lacks something gives away; 0 where none does.
        window: (N, q) length of the window that each estimate is of, samples; 0 while warming.
        channel: (N,) the channel (outputs, then inputs) whose sensor may be what changed; -1 where none is blamed.
        still: (N,) nothing moves in the window.
        each_theta, each_sd: (N, L, q) what each of L windows says, shortest first, where there are several (else L is
            0); NaN where a window is not whole.
        each_dof: (N, L) their degrees of freedom.
        each_fits: (N, L) the window is undisturbed.
        diverged: (N,) the method failed or its passes did not settle: there is no estimate to believe.
    """

    index: IntArray
    theta: FloatArray
    sd: FloatArray
    dof: FloatArray
    full: BoolArray
    changing: BoolArray
    mismatch: BoolArray
    ratio: FloatArray
    suspect: IntArray
    window: IntArray
    channel: IntArray
    still: BoolArray
    each_theta: FloatArray
    each_sd: FloatArray
    each_dof: FloatArray
    each_fits: BoolArray
    diverged: BoolArray

    @classmethod
    def warming(cls, index: IntArray, q: int, windows: int = 0) -> "Rows":
        """Return rows without estimates, with room for those of several windows."""
        count = len(index)
        nothing, no = np.full((count, q), np.nan), np.zeros(count, dtype=bool)
        unknown, none = np.full(count, np.nan), np.zeros(count, dtype=np.int64)
        window, channel = np.zeros((count, q), dtype=np.int64), np.full(count, -1, dtype=np.int64)
        return cls(
            index, nothing, nothing.copy(), unknown, no, no.copy(), no.copy(), unknown.copy(), none, window, channel,
            no.copy(), np.full((count, windows, q), np.nan), np.full((count, windows, q), np.nan),
            np.full((count, windows), np.nan), np.zeros((count, windows), dtype=bool),
            no.copy(),
        )  # fmt: skip

    @classmethod
    def joined(cls, pieces: "list[Rows]", q: int) -> "Rows":
        """Return rows one after the other."""
        if len(pieces) == 1:
            return pieces[0]
        pieces = pieces or [cls.warming(np.zeros(0, np.int64), q)]
        return cls(*(np.concatenate([getattr(piece, f.name) for piece in pieces]) for f in fields(cls)))

    def part(self, stop: int) -> "Rows":
        """Return the first `stop` rows."""
        return Rows(*(getattr(self, f.name)[:stop] for f in fields(self)))
