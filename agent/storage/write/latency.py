"""How long it takes from a sample to its row on the disk: a histogram, as monitoring systems gather it."""

from bisect import bisect_left
from dataclasses import dataclass, field

BOUNDS_S = (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, 5.0, 10.0, 60.0)
"""Upper ends of the bins, s; one more bin takes all beyond. Rows wait for a batch a second."""


@dataclass(slots=True)
class Histogram:
    """Counts of what was observed, a bin each, and the sum."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS_S) + 1))
    sum_s: float = 0.0

    def observe(self, seconds: float) -> None:
        """Count one value."""
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.sum_s += seconds

    def cumulated(self) -> list[tuple[str, int]]:
        """Return each bin's upper end, as text, with the count of all values up to it."""
        ends = [*map(str, BOUNDS_S), "+Inf"]
        return [(end, sum(self.counts[: i + 1])) for i, end in enumerate(ends)]
