"""How samples fall into hops, windows and cells."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.window.tuning import CELL_TARGET
from agent.types import IntArray


@dataclass(frozen=True, slots=True)
class HopPlan:
    """How samples fall into hops: `window` W and `hop` H samples.

    Windows start at multiples of H, counted from the run's first sample, and consist of F whole hops and a
    head of 1..H samples; a row falls due at each head's last sample.
    """

    window: int
    hop: int

    @property
    def head(self) -> int:
        """Samples of a window in its last hop, 1..H."""
        return self.window % self.hop or self.hop

    @property
    def fulls(self) -> int:
        """Whole hops in a window before its last one, F."""
        return (self.window - self.head) // self.hop

    @property
    def rest(self) -> int:
        """Samples of a hop after its head, 0..H-1."""
        return self.hop - self.head

    def samples(self, fulls: int) -> int:
        """Return the length of a window of so many whole hops and a head."""
        return fulls * self.hop + self.head

    def rows_between(self, start: int, stop: int) -> IntArray:
        """Return the sample indices in [start, stop) at which rows fall due."""
        return np.arange(start + (self.head - 1 - start) % self.hop, stop, self.hop, dtype=np.int64)


def divide(length: int) -> tuple[int, ...]:
    """Cut a stretch into nearly equal cells of about CELL_TARGET samples."""
    if not length:
        return ()
    parts = max(1, round(length / CELL_TARGET))
    return tuple(length // parts + (i < length % parts) for i in range(parts))
