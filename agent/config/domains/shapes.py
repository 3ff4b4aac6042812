"""The matrices of a beam between its two ends, and the motions that holding leaves free."""

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from agent.types import FloatArray

ROUND_OFF: Final = 1e-12


def bending(length: float) -> "FloatArray":
    """Return the stiffness of a beam of EI = 1, (6, 6), along each end left out."""
    import numpy as np

    a = length
    inner = np.array([[12, 6 * a, -12, 6 * a], [6 * a, 4 * a * a, -6 * a, 2 * a * a]]) / a**3
    other = np.array([[-12, -6 * a, 12, -6 * a], [6 * a, 2 * a * a, -6 * a, 4 * a * a]]) / a**3
    return _placed(np.vstack([inner, other]), np.zeros((2, 2)))


def weight(length: float) -> "FloatArray":
    """Return the consistent mass of a beam of 1 kg/m, (6, 6)."""
    import numpy as np

    a = length
    one = [[156, 22 * a, 54, -13 * a], [22 * a, 4 * a * a, 13 * a, -3 * a * a]]
    other = [[54, 13 * a, 156, -22 * a], [-13 * a, -3 * a * a, -22 * a, 4 * a * a]]
    return _placed(np.array(one + other) * a / 420, np.array([[2.0, 1.0], [1.0, 2.0]]) * a / 6)


def _placed(across: "FloatArray", along: "FloatArray") -> "FloatArray":
    """Return (6, 6) of a beam from its bending part and its part along."""
    import numpy as np

    whole = np.zeros((6, 6))
    whole[np.ix_([1, 2, 4, 5], [1, 2, 4, 5])] = across
    whole[np.ix_([0, 3], [0, 3])] = along
    return whole


def unit(place: int, count: int) -> "FloatArray":
    """Return (count,) zeros with a 1 at a place."""
    import numpy as np

    return np.asarray(np.eye(count)[place])


def kernel(rows: "FloatArray") -> "FloatArray":
    """Return a basis (count, f) of what rows @ z = 0 leaves free, each vector 1 where all others are 0."""
    import numpy as np

    left = rows.copy()
    pivots: list[tuple[int, int]] = []
    for column in range(rows.shape[1] - 1, -1, -1):
        free = [i for i in range(len(left)) if i not in [row for row, _ in pivots]]
        best = max(free, key=lambda i: abs(left[i, column]), default=None)
        if best is None or abs(left[best, column]) < ROUND_OFF:
            continue
        left[best] /= left[best, column]
        others = [i for i in range(len(left)) if i != best]
        left[others] -= np.outer(left[others, column], left[best])
        pivots.append((best, column))
    held = {column: row for row, column in pivots}
    basis = [unit(place, rows.shape[1]) for place in range(rows.shape[1]) if place not in held]
    for vector in basis:
        for column, row in held.items():
            vector[column] = -left[row] @ np.where(np.isin(np.arange(len(vector)), list(held)), 0.0, vector)
    return np.array(basis).T.reshape(rows.shape[1], -1)
