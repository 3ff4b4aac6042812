"""Matrix products in which each row's result does not depend on how many rows there are.

The kernels of a BLAS round a product's last few rows differently from the others, so a hop computed alone differs in
its last bits from the same hop among many. Windows that are short against a mode's period magnify that. With rows
added up to a multiple of ROWS every row takes the way of the others.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ROWS = 16
"""Rows that every kernel in use takes at once, or a multiple of that."""


def row_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return left (N, k) @ right (k, m) with rows that do not depend on N."""
    count = len(left)
    short = -count % ROWS
    if not short:
        return np.asarray(left @ right)
    padded = np.zeros((count + short, left.shape[1]))
    padded[:count] = left
    return np.asarray((padded @ right)[:count])


def column_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return left (m, k) @ right (k, N) with columns that do not depend on N."""
    count = right.shape[1]
    short = -count % ROWS
    if not short:
        return np.asarray(left @ right)
    padded = np.zeros((len(right), count + short))
    padded[:, :count] = right
    return np.ascontiguousarray((left @ padded)[:, :count])
