"""The newest rows of a growing table, appended in place and let go of in large pieces."""

import numpy as np

from agent.types import FloatArray


class Tail:
    """Numbered rows of equal width, the oldest of which may be let go.

    Args:
        first: number of the first row.
        width: columns.
    """

    def __init__(self, first: int, width: int) -> None:
        self.first = first
        self.stop = first
        self._table: FloatArray = np.empty((64, width))

    def append(self, rows: FloatArray) -> None:
        """Add rows (N, width) at the end."""
        used = self.stop - self.first
        if used + len(rows) > len(self._table):
            larger = np.empty((2 * (used + len(rows)), self._table.shape[1]))
            larger[:used] = self._table[:used]
            self._table = larger
        self._table[used : used + len(rows)] = rows
        self.stop += len(rows)

    def part(self, start: int, stop: int) -> FloatArray:
        """Return rows [start, stop) by their numbers, as a view."""
        return self._table[start - self.first : stop - self.first]

    def forget(self, oldest: int) -> None:
        """Let go of the rows before number `oldest`."""
        self._table = self.part(oldest, self.stop).copy()
        self.first = oldest
