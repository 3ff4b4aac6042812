"""Channels that froze: they read the same to the last digit through a whole window that no parameters explain.

A force may rest while the rig moves on, so that one which stands still is no fault by itself, as a displacement's is
(`standing`); nor is anything to be seen where every channel froze together. But where a window is not explained, a
channel that never stood so in a window that was tells why.
"""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.faults.suspects import Accusation, ChannelSuspect

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
EQUAL = 1e-12
"""Readings that differ by this share of their size are the same: what was filled in may miss by a rounding error."""


def standing(v: FloatArray) -> BoolArray:
    """(c,) which channels read the same all through a window v (W, c)."""
    return np.asarray(np.ptp(v, axis=0) <= EQUAL * np.abs(v[-1]))


class Frozen:
    """Remembers how the measured channels, so many outputs, then so many inputs, stand still in health.

    commanded: inputs are what was commanded: one that is held is where it was put, and tells nothing of a sensor.
    """

    def __init__(self, outputs: int, inputs: int, *, commanded: bool = False) -> None:
        self._outputs, self._channels = outputs, (channels := outputs + inputs)
        self._believed = np.arange(channels) >= (outputs if commanded else channels)
        self._moved = np.zeros(channels, dtype=bool)
        self._low, self._high = np.full(channels, np.inf), np.full(channels, -np.inf)  # where they stood in health

    def note(self, v: FloatArray, ends: IntArray, window: int) -> None:
        """Take windows of samples v (W, c) that were explained; they end before rows `ends` (N,)."""
        first, last = v[ends - window, : self._channels], v[ends - 1, : self._channels]
        # one that ends where it began may have stood still all the time
        alike = np.abs(last - first) <= EQUAL * np.abs(last)
        self._moved |= ~alike.all(axis=0)
        for row in np.flatnonzero(alike.any(axis=1)).tolist():
            stands, at = self._stands(v[ends[row] - window : ends[row]]), last[row]
            self._moved |= ~stands
            self._low = np.where(stands, np.minimum(self._low, at), self._low)
            self._high = np.where(stands, np.maximum(self._high, at), self._high)

    def find(self, v: FloatArray) -> Accusation | None:
        """Return the channels that froze in a window v (W, c) that was not explained; None for none."""
        at = v[-1, : self._channels]
        rests = (at >= self._low) & (at <= self._high)
        return self._accusation(self._stands(v) & self._moved & ~rests, at)

    def find_unmoved(self, v: FloatArray) -> Accusation | None:
        """Return the channels that tell nothing in the first windows v (W, c), none of which was explained.

        An output that stands still while others move is stuck. An input that reads 0 is one that does nothing; where
        all of them stand elsewhere none of them was ever seen to work.
        """
        if self._moved.any():
            return None
        at, stands = v[-1, : self._channels], self._stands(v)
        outputs, inputs = stands[: self._outputs], stands[self._outputs :]
        stuck = np.concatenate([outputs & ~outputs.all(), inputs & inputs.all() & (at[self._outputs :] != 0)])
        return self._accusation(stuck, at)

    def resting(self, v: FloatArray) -> Accusation | None:
        """Return that no measured force explains the motion in the first windows v (W, c): all of them rest at 0."""
        stands = self._stands(v)
        outputs, inputs = stands[: self._outputs], stands[self._outputs :]
        nobody = not len(inputs) or bool(self._believed[-1])
        if nobody or self._moved.any() or outputs.all() or not inputs.all():
            return None
        return Accusation(ChannelSuspect("forces", tuple(range(self._outputs, self._channels))), 1.0)

    def _accusation(self, stuck: BoolArray, at: FloatArray) -> Accusation | None:
        channels = np.flatnonzero(stuck & ~self._believed)
        if not len(channels):
            return None
        return Accusation(ChannelSuspect("stuck", tuple(channels.tolist())), 1.0, sizes=tuple(at[channels].tolist()))

    def _stands(self, v: FloatArray) -> BoolArray:
        """(channels,) which read the same all through a window."""
        return standing(v[:, : self._channels])
