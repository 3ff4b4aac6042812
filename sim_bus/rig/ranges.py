"""Runs of sample numbers, kept as (first, last), for the ledger."""

import numpy as np

from sim_bus.arrays import IntArray
from sim_bus.tuning import MOST_RUNS


class Runs:
    """Sample numbers that only grow, as runs; beyond MOST_RUNS runs only the number of samples is kept on."""

    def __init__(self) -> None:
        self._runs: list[tuple[int, int]] = []
        self.samples = 0

    def add(self, first: int, last: int) -> None:
        """Add first .. last."""
        self.samples += last - first + 1
        if self._runs and first <= self._runs[-1][1] + 1:
            self._runs[-1] = (self._runs[-1][0], max(last, self._runs[-1][1]))
        elif len(self._runs) < MOST_RUNS:
            self._runs.append((first, last))

    def add_each(self, index: IntArray) -> None:
        """Add single numbers, in order."""
        if not len(index):
            return
        edges = np.flatnonzero(np.diff(index) > 1)
        firsts, lasts = index[np.r_[0, edges + 1]], index[np.r_[edges, len(index) - 1]]
        for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True):
            self.add(first, last)

    def numbers(self, end: int) -> set[int]:
        """Return the numbers below `end` one by one."""
        return {number for first, last in self.before(end) for number in range(first, last + 1)}

    def before(self, end: int) -> list[tuple[int, int]]:
        """Return the runs below `end`."""
        return [(first, min(last, end - 1)) for first, last in self._runs if first < end]
