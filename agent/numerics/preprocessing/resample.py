"""Readings between samples: cubic interpolation of a stream that may have gaps.

Displacement is smooth on the scale of a sample (a force moves it only through two integrations), so four
readings are enough: halfway between samples what is left of a white force of 5 N on 3 kg at 1 kHz is 0.1
micrometre.
"""

import numpy as np

from agent.numerics.preprocessing.tuning import ON_A_SAMPLE
from agent.types import FloatArray, IntArray

BEFORE, AFTER = 1, 2
"""Fixed by cubic interpolation: readings that are needed before and after the one at or before a place
between samples."""


def split(place: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the reading's number at or before each place, and how far behind it the place lies, 0 .. 1."""
    whole = np.floor(place + ON_A_SAMPLE)
    part = place - whole
    return whole.astype(np.int64), np.where(part < ON_A_SAMPLE, 0.0, part)


def weights(part: FloatArray) -> FloatArray:
    """Return the weights (n, 4) of the readings -1, 0, 1, 2 for places (n,) between 0 and 1 (Lagrange)."""
    f = part
    return np.stack(
        [
            -f * (f - 1) * (f - 2) / 6,
            (f + 1) * (f - 1) * (f - 2) / 2,
            -(f + 1) * f * (f - 2) / 2,
            (f + 1) * f * (f - 1) / 6,
        ],
        axis=-1,
    )


def interpolated(index: IntArray, values: FloatArray, whole: IntArray, part: FloatArray) -> FloatArray:
    """Return readings (n,) at places whole + part (n,) of a stream.

    Args:
        index: (k,) numbers of its readings, increasing.
        values: (k,) its readings, NaN where one is missing.
        whole: (n,) numbers of the readings at or before the places, as `split` gives them.
        part: (n,) how far behind these the places lie.

    NaN where a reading that is needed is missing.
    """
    result = np.full(len(whole), np.nan)
    if not len(index):
        return result
    at = np.minimum(np.searchsorted(index, whole), len(index) - 1)
    there = index[at] == whole
    exact = there & (part == 0)
    result[exact] = values[at[exact]]
    first, last = at - BEFORE, at + AFTER
    inside = there & (part > 0) & (first >= 0) & (last < len(index))
    rows = np.flatnonzero(inside)
    # increasing numbers: the outer two are where they should be only if the inner ones are as well
    rows = rows[index[last[rows]] - index[first[rows]] == BEFORE + AFTER]
    around = values[first[rows][:, None] + np.arange(BEFORE + AFTER + 1)]
    result[rows] = np.einsum("ij,ij->i", weights(part[rows]), around)
    return result
