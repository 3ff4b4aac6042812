"""Readings side by side, as a window's regression takes them."""

import numpy as np

from agent.types import FloatArray


def side_by_side(u: FloatArray, offsets: tuple[int, ...]) -> FloatArray:
    """Return v (N - span, taps * m) of inputs u (N, m), the first row of sample -offsets[0]."""
    rows = max(len(u) - (offsets[-1] - offsets[0]), 0)
    return np.hstack([u[o - offsets[0] : o - offsets[0] + rows] for o in offsets])
