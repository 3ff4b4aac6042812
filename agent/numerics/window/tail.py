"""Tables that grow at their ends and may lose their oldest rows; and which samples are marked, counted."""

from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from agent.types import BoolArray, IntArray

T = TypeVar("T", bound=np.generic)


class Tail(Generic[T]):
    """Numbered rows of equal width, the oldest of which may be let go.

    Args:
        first: number of the first row.
        rows: (N, ..) the rows there are at first.
    """

    def __init__(self, first: int, rows: NDArray[T]) -> None:
        self.first = first
        self.stop = first + len(rows)
        self._table = rows

    def append(self, rows: NDArray[T]) -> None:
        """Add rows (N, ..) at the end."""
        self.more(len(rows))[:] = rows

    def more(self, count: int) -> NDArray[T]:
        """Add rows at the end that are still to be filled; return them, as a view."""
        used = self.stop - self.first
        if used + count > len(self._table):
            larger = np.empty((2 * (used + count), *self._table.shape[1:]), self._table.dtype)
            larger[:used] = self.held()
            self._table = larger
        self.stop += count
        return self._table[used : used + count]

    def held(self) -> NDArray[T]:
        """Return all rows, as a view."""
        return self._table[: self.stop - self.first]

    def part(self, start: int, stop: int) -> NDArray[T]:
        """Return rows [start, stop) by their numbers, as a view."""
        return self._table[start - self.first : stop - self.first]

    def forget(self, oldest: int) -> None:
        """Let go of the rows before number `oldest`."""
        self._table = self.part(oldest, self.stop).copy()
        self.first = oldest


class MarkCounts:
    """Which samples from number `first` on are marked, as how many before each of them are."""

    def __init__(self, first: int) -> None:
        self._before = Tail(first, np.zeros(1, dtype=np.int64))

    def append(self, marks: BoolArray) -> None:
        """Take marks (N,) of further samples."""
        before = self._before.held()[-1]
        total = self._before.more(len(marks))
        total[:] = before + np.cumsum(marks) if marks.any() else before

    def count(self, index: IntArray, samples: int) -> IntArray:
        """Return how many of so many samples (N,) that end at samples `index` are marked."""
        before = self._before.held()
        stop = index + 1 - self._before.first
        return np.asarray(before[stop] - before[np.maximum(stop - samples, 0)])

    def clear(self, sample: int) -> None:
        """Take the mark of a sample that has one away."""
        self._before.part(sample + 1, self._before.stop)[:] -= 1

    def forget(self, oldest: int) -> None:
        """Let go of the samples before number `oldest`."""
        self._before.forget(oldest)
