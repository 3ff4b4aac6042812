"""Where samples of sources that are resampled end up: each sample goes with the row nearest to it."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from agent.types import IntArray, Samples


@dataclass(slots=True)
class Tally:
    """The samples of one source on their way through rows.

    A row takes along as many samples as fell to it: one, seldom none or two where the device's clock runs at
    its own speed, several where the device is the faster one.

    Attributes:
        used: samples of rows that entered the estimation whole.
        rejected: samples of rows that were refused, by reason.
    """

    used: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    _rows: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _weight: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def waiting(self) -> int:
        """Samples of rows that are not through yet."""
        return int(self._weight.sum())

    def send(self, rows: IntArray, weight: IntArray) -> None:
        """Note rows (n,) that are handed on whole, and the samples (n,) that go with each."""
        self._rows, self._weight = np.concatenate([self._rows, rows]), np.concatenate([self._weight, weight])

    def refuse(self, reason: str, count: int) -> None:
        """Note samples of which no row is made."""
        if count:
            self.rejected[reason] += count

    def lose(self, reason: str) -> None:
        """Refuse the samples of the rows that are not through: they will not come out."""
        self.refuse(reason, self.waiting)
        self._rows, self._weight = self._rows[:0], self._weight[:0]

    def arrive(self, samples: Samples) -> None:
        """Note rows that came out of the quality block."""
        last = int(np.searchsorted(self._rows, samples.index[-1], side="right"))
        mine, weight = self._rows[:last], self._weight[:last]
        self._rows, self._weight = self._rows[last:], self._weight[last:]
        at = np.searchsorted(mine, samples.index)
        found = at < len(mine)
        found[found] = mine[at[found]] == samples.index[found]
        counts = np.where(found, weight[np.minimum(at, max(len(mine) - 1, 0))] if len(mine) else 0, 0)
        if samples.usable:
            sound = samples.complete
            self.used += int(counts[sound].sum())
            self.refuse("spike", int(counts[~sound].sum()))
        elif samples.fault is not None:
            self.refuse(samples.fault.reason.name.lower(), int(counts.sum()))
        self.refuse("unpaired", int(weight.sum() - counts.sum()))
