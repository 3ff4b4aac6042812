"""Reductions over each sample's few channels: numpy's own, along so short an axis, cost ten times as much.

So do its differences of few samples after one that came before them.
"""

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from agent.types import BoolArray, FloatArray, IntArray

T = TypeVar("T", bound=np.generic)


def rows_with(marks: BoolArray) -> BoolArray:
    """Return which rows (N,) of marks (N, c) hold one."""
    found = np.zeros(len(marks), dtype=bool)
    for column in marks.T:
        found |= column
    return found


def rows_that_change(v: FloatArray) -> BoolArray:
    """Return which rows (N-1,) of v (N, c), but for the first, differ from the one before them."""
    found = np.zeros(len(v) - 1, dtype=bool)
    for column in v.T:
        found |= column[1:] != column[:-1]
    return found


def largest_in(v: FloatArray) -> FloatArray:
    """Return the largest value (c,) of each column of v (N, c), at least 0; 0 of no rows."""
    return np.array([column.max(initial=0.0) for column in v.T])


def followed(before: NDArray[T], after: NDArray[T]) -> NDArray[T]:
    """Return samples (N, c) with later ones behind them, each channel's readings side by side in memory."""
    return np.concatenate([before.T, after.T], axis=1).T


def least_of_parts(v: FloatArray, length: int) -> FloatArray:
    """Return the smallest value (c, parts) of each stretch of so many readings of v (c, N)."""
    return np.asarray(np.minimum.reduceat(v, np.arange(0, v.shape[1], length), axis=1))


def columns_with(marks: BoolArray) -> list[int]:
    """Return the columns of marks (N, c) that hold one."""
    return [number for number, column in enumerate(marks.T) if column.any()]


def steps_from(before: int, index: IntArray) -> IntArray:
    """Return by how much each number (n,) is larger than the one before it, the first than `before`."""
    steps = index.astype(np.int64)
    steps[:1] -= before
    steps[1:] -= index[:-1]
    return steps
