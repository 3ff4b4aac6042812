"""The step that recorded readings are whole multiples of: that of a converter, or of a text's decimals."""

import numpy as np

from drivers.files.tuning import CLOSEST, FEW, NEARLY_ALL, ON_GRID, RESOLVED
from drivers.port import FloatArray

REACHES = (1e5, 1e7, np.inf)
"""Steps from the origin, nearest first, over which a step is made more precise: the farther the more."""


def grid_step(values: FloatArray) -> float:
    """Return the step between the levels of readings (n,) if nearly all are whole steps apart, else 0.

    It is the common divisor of the closest levels, whichever of them follow one another in time: of 16 bits
    most readings differ from the next by many steps. Where it is less than the readings resolve, there is
    none.
    """
    finite = values[np.isfinite(values)]
    least = RESOLVED * float(np.abs(finite).max(initial=0.0))
    levels = np.unique(finite)
    apart = np.diff(levels)
    apart = np.sort(apart[apart > least])[:CLOSEST]
    if not len(apart):
        return 0.0
    step = _divisor(apart, least)
    offsets = finite - (levels[len(levels) // 2] if len(levels) >= FEW else 0.0)
    step = _refined(step, offsets) if step > least else 0.0
    return step if step > 0 and _fits(step, offsets) else 0.0


def _divisor(lengths: FloatArray, least: float) -> float:
    """Return the greatest common divisor of lengths (n,) by Euclid, what is under `least` being nothing."""
    found = float(lengths[0])
    for length in lengths[1:].tolist():
        larger, rest = length, found
        while rest > least:
            larger, rest = rest, abs(larger - rest * round(larger / rest))
        found = larger
        if found <= least:
            break
    return found


def _refined(step: float, offsets: FloatArray) -> float:
    """Return a step as precise as offsets (n,) tell it: that of the closest levels carries their rounding."""
    for reach in REACHES:
        near = offsets[np.abs(offsets) <= reach * step]
        counts = np.rint(near / step)
        if counts.any():
            step = float(near @ counts / (counts @ counts))
    return step


def _fits(step: float, offsets: FloatArray) -> bool:
    multiples = offsets / step
    return bool(np.mean(np.abs(multiples - np.rint(multiples)) < ON_GRID) > NEARLY_ALL)
