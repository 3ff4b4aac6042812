"""Samples that carry a mark, and how many of them windows hold."""

import numpy as np

from agent.types import BoolArray, IntArray


class Marks:
    """Numbers of marked samples of a segment, in order."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin a new segment."""
        self._samples: IntArray = np.zeros(0, dtype=np.int64)

    def append(self, index: int, marked: BoolArray) -> None:
        """Note which of the samples from number `index` on are marked (N,)."""
        found = np.flatnonzero(marked)
        if len(found):
            self._samples = np.concatenate([self._samples, found + index])

    def count(self, index: IntArray, window: IntArray | int) -> IntArray:
        """Return how many marked samples (N,) the windows that end with samples `index` (N,) hold."""
        stop = np.searchsorted(self._samples, index, side="right")
        return np.asarray(stop - np.searchsorted(self._samples, index - window, side="right"), dtype=np.int64)

    def trim(self, oldest: int) -> None:
        """Forget what lies before a sample."""
        if len(self._samples) and self._samples[0] < oldest:
            self._samples = self._samples[self._samples >= oldest]
