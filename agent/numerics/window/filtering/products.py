"""Matrix products in which each row's result does not depend on how many rows there are.

The kernels of a BLAS round a product's last few rows differently from the others, so a hop computed alone
differs in its last bits from the same hop among many. Where products are of ROWS rows or multiples of it, the
last ones filled up, every row takes the same way.
"""

import numpy as np

from agent.numerics.window.tuning import ROWS
from agent.types import FloatArray


def row_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return left (..., k) @ right (k, m) with rows that do not depend on how many there are."""
    rows = left if left.ndim == 2 else left.reshape(-1, left.shape[-1])
    count = len(rows)
    whole = count - count % ROWS
    products: FloatArray
    if whole == count:
        products = rows.dot(right)
    elif not whole:  # as nearly always while an agent runs
        filled = np.zeros((ROWS, rows.shape[1]))
        filled[:count] = rows
        products = filled.dot(right)[:count]
    else:
        products = np.empty((count, right.shape[1]))
        np.matmul(rows[:whole], right, out=products[:whole])
        products[whole:] = row_products(rows[whole:], right)
    return products if rows is left else products.reshape(*left.shape[:-1], right.shape[1])


def stacked_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return left (b, N, .., k) @ right (b, k, m): `row_products` of each of b pairs."""
    rows = left.reshape(len(left), -1, left.shape[-1])
    count = rows.shape[1]
    if count % ROWS:
        filled = np.zeros((len(rows), count + -count % ROWS, rows.shape[2]))
        filled[:, :count] = rows
        rows = filled
    return np.asarray((rows @ right)[:, :count].reshape(*left.shape[:-1], right.shape[2]))
