"""Singular values by QR iteration.

LAPACK's divide and conquer, which numpy takes, does not converge on some graded matrices of more than 25
columns, or returns vectors that are none, depending on the kernels (OpenBLAS issue 3044): of the bank of a
rig of five masses it failed three times in 80 windows, and one factor of 300 of other rigs was off by 2e-7.
"""

import numpy as np
from scipy.linalg import qr, svd

from agent.types import FloatArray


def singular(matrix: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return left vectors (m, k), values (k,) and right vectors (k, n) of a matrix (m, n), k = min(m, n).

    Raises:
        LinAlgError: an entry is no number.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("singular values of what is no number")
    left, values, right = svd(matrix, full_matrices=False, check_finite=False, lapack_driver="gesvd")
    return np.asarray(left), np.asarray(values), np.asarray(right)


def leading(matrix: FloatArray, least: float) -> tuple[FloatArray, FloatArray]:
    """Return singular values (r,) beyond `least` of the largest and right vectors (r, n), of m ≥ n rows.

    Triangular first, pivoted (Golub & Van Loan, Matrix Computations, 5.4): its rows fall off with the values,
    and few are left where few values are. What is left out moves values by about `least` of the largest.
    """
    triangle, order = qr(matrix, mode="r", pivoting=True)
    sizes = np.abs(np.diagonal(triangle))
    rows = int((sizes > least * sizes[0]).sum())
    _, values, pivoted = singular(np.asarray(triangle[:rows], dtype=np.float64))
    rank = int((values > least * values[0]).sum())
    right = np.empty((rank, len(order)))
    right[:, order] = pivoted[:rank]
    return values[:rank], right
