"""The commissioning factor: how far healthy windows scatter beyond the sd that they state.

What no single window can see (noise that is correlated over longer than a window) shows in the scatter of many.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

WINDOWS = 60
"""Disjoint healthy windows without a change that the factor is taken from."""
LEAST = 0.5
"""No factor is below this."""


@dataclass(slots=True)
class Commission:
    """Collects disjoint healthy windows until there are enough.

    Attributes:
        factor: (q,) what every stated sd is multiplied by; ones until known.
        known: whether the factor has been taken.
    """

    factor: FloatArray
    known: bool = False
    _theta: list[FloatArray] = field(default_factory=list)
    _sd: list[FloatArray] = field(default_factory=list)

    @property
    def missing(self) -> int:
        """Windows still to come; 0 when known."""
        return 0 if self.known else WINDOWS - len(self._theta)

    def restart(self) -> None:
        """Begin to collect anew: something changed."""
        self._theta.clear()
        self._sd.clear()

    def adopt(self, factor: FloatArray) -> None:
        """Take a factor that is known already."""
        self.factor, self.known = factor, True

    def add(self, theta: FloatArray, sd: FloatArray) -> bool:
        """Take windows theta, sd (N, q); return whether that completed the collection."""
        if self.known:
            return False
        self._theta.extend(theta)
        self._sd.extend(sd)
        if len(self._theta) < WINDOWS:
            return False
        self.factor = _factor(np.array(self._theta), np.array(self._sd))
        self.known = True
        self.restart()
        return True


def _factor(theta: FloatArray, sd: FloatArray) -> FloatArray:
    weight = 1.0 / sd**2
    mean = np.sum(weight * theta, axis=0) / np.sum(weight, axis=0)
    count = len(theta)
    scatter = np.sqrt(np.mean(((theta - mean) / sd) ** 2, axis=0) * count / (count - 1))
    # the logarithm of a scatter has a standard deviation of 1 / sqrt(2 count) by chance alone; what is beyond that is
    # believed as far as the positive-part estimator of James and Stein (1961) would
    chance2, seen = 0.5 / count, np.log(np.maximum(scatter, 1e-300))
    believed = np.maximum(1.0 - chance2 / np.maximum(seen**2, 1e-300), 0.0)
    return np.asarray(np.maximum(np.exp(believed * seen), LEAST))
