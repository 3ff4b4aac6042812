"""A window's frequencies: bins kept one by one, and groups of high bins of which residual power is kept."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from agent.numerics.inference.tuning import HIGH_GROUPS, MOST_BINS
from agent.types import ComplexArray, FloatArray, IntArray


def unitary(x: FloatArray) -> ComplexArray:
    """Return the unitary DFT of real columns x (W, ...), bins 0 .. W/2."""
    return np.asarray(np.fft.rfft(x, axis=0) / np.sqrt(len(x)))


@dataclass(frozen=True)
class Bins:
    """Which bins of a window of W samples are used, and how.

    Attributes:
        window: W.
        kept: the lowest bins, kept with every column.
    """

    window: int
    kept: int

    @cached_property
    def multiplicity(self) -> FloatArray:
        """(W//2+1,) how many bins of the full DFT each stands for: 2 for those with a mirror image."""
        twice = np.full(self.total, 2.0)
        twice[0] = 1.0
        if self.window % 2 == 0:
            twice[-1] = 1.0
        return twice

    @property
    def total(self) -> int:
        """Number of bins of a real window."""
        return self.window // 2 + 1

    @cached_property
    def high(self) -> IntArray:
        """Bins above those kept whose residual power is used: all of them, or an even spread."""
        rest = self.total - self.kept
        if rest <= 0:
            return np.zeros(0, dtype=np.int64)
        spread = np.unique(np.linspace(0, rest - 1, min(rest, MOST_BINS)).astype(np.int64))
        return np.asarray(self.kept + spread)

    @cached_property
    def _edges(self) -> IntArray:
        if not len(self.high):
            return np.zeros(1, dtype=np.int64)
        edges = np.unique(np.round(np.geomspace(self.kept, self.total, HIGH_GROUPS + 1)).astype(np.int64))
        filled = np.diff(np.searchsorted(self.high, edges)) > 0
        edges = edges[np.concatenate([[True], filled])]
        edges[-1] = self.total
        return np.asarray(edges)

    @property
    def groups(self) -> int:
        """Number of groups of high bins."""
        return len(self._edges) - 1

    @cached_property
    def starts(self) -> IntArray:
        """(groups,) the first of `high` in each group."""
        return np.searchsorted(self.high, self._edges[:-1])

    @cached_property
    def group_of(self) -> IntArray:
        """(len(high),) the group of each high bin."""
        sizes = np.diff(np.append(self.starts, len(self.high)))
        return np.repeat(np.arange(self.groups), sizes)

    @cached_property
    def z(self) -> ComplexArray:
        """(kept + groups,) exp(i ω) of kept bins, then of the groups' centres."""
        centres = (
            np.round(np.sqrt(self._edges[:-1] * (self._edges[1:] - 1.0))) if self.groups else np.zeros(0)
        )
        return np.exp(2j * np.pi * np.concatenate([np.arange(self.kept), centres]) / self.window)

    @cached_property
    def z_high(self) -> ComplexArray:
        """(len(high),) exp(i ω) of the high bins."""
        return np.asarray(np.exp(2j * np.pi * self.high / self.window))

    @cached_property
    def weight(self) -> FloatArray:
        """(kept + groups,) how many bins of the full DFT each cell stands for."""
        if not self.groups:
            return self.multiplicity[: self.kept]
        grouped = np.add.reduceat(self.multiplicity[self.high], self.starts)
        return np.concatenate([self.multiplicity[: self.kept], grouped])

    def without(self, dropped: NDArray[np.bool_]) -> FloatArray:
        """Return the weights with those of dropped cells (kept + groups,) zero."""
        return np.where(dropped, 0.0, self.weight)


@lru_cache(maxsize=8)
def bins_of(window: int, kept: int) -> Bins:
    """Return the bins of windows of a length, the same ones at every point of linearisation."""
    return Bins(window, kept)
