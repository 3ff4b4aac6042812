"""Readings as they come, before scale, offset and unit: that is where tables and displays round them."""

from dataclasses import dataclass

import numpy as np

from agent.types import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Wire:
    """How c channels' readings become SI values: reading * unit + zero.

    Attributes:
        unit: (c,) size of 1, SI, above 0: the sign of a scale says nothing of how readings are rounded.
        zero: (c,) SI value of 0.
    """

    unit: FloatArray
    zero: FloatArray

    @classmethod
    def in_si(cls, channels: int) -> "Wire":
        """Return the wire of channels that come in SI."""
        return cls(np.ones(channels), np.zeros(channels))

    def readings(self, values: FloatArray) -> FloatArray:
        """Return SI values (..., c) as they came, but for their sign."""
        return np.asarray((values - self.zero) / self.unit)

    def part(self, channels: slice) -> "Wire":
        """Return the same of some channels."""
        return Wire(self.unit[channels], self.zero[channels])
