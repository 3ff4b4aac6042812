"""The window estimate: least squares of the innovations on their sensitivities, the initial state projected out.

In a window that starts at k0 the innovations are e(k) = Gamma_k e0 + sum psi_i(k) delta_i + noise. The unknown e0 is
eliminated by variable projection (Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973) 413), with the sensitivities
re-evaluated at the window's own best initial state, so that the estimate depends on samples inside the window only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.window.cells import Summary
from agent.numerics.window.products import row_products

FloatArray = NDArray[np.float64]

RANK_TOLERANCE = 1e-13
"""Directions of the initial state with less than this share of the strongest (after scaling) are left out."""


@dataclass(frozen=True, slots=True)
class WindowSolution:
    """What N windows say about theta - theta_r.

    Attributes:
        delta: (N, q) estimated theta - theta_r; NaN where the window says nothing.
        covariance: (N, q, q) for unit noise variance: multiply by s2.
        residual: (N,) sum of squares left, noise units.
        explained: (N,) sum of squares that delta takes away: its chi-square.
        e0: (N, n) error of the observer's state at the start of the window.
        information: (N, q, q) H, the inverse of the covariance.
    """

    delta: FloatArray
    covariance: FloatArray
    residual: FloatArray
    explained: FloatArray
    e0: FloatArray
    information: FloatArray


def pseudo_root(gram: FloatArray) -> FloatArray:
    """Return F with F F' the pseudo-inverse of a Gram matrix (n, n), its columns scaled to unit length first."""
    diagonal = np.diag(gram)
    scale = np.where(diagonal > 0, 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    kept = values > RANK_TOLERANCE * max(float(values[-1]), 0.0)
    return np.asarray((scale[:, None] * vectors[:, kept]) / np.sqrt(values[kept]))


def solve_windows(window: Summary, n: int, prior: FloatArray | None = None) -> WindowSolution:
    """Estimate theta - theta_r in each of N windows from their summaries.

    Args:
        window: summaries over whole windows, N of them.
        n: number of states.
        prior: (q,) optional precision added to the diagonal of the information, in noise units.
    """
    e0, reduced = _project(window, n)
    g, H = reduced[:, 1:, 0], reduced[:, 1:, 1:]
    if prior is not None:
        H = H + np.diag(prior)
    covariance, solvable = _inverse(H)
    # what a window cannot tell explains nothing of its residual either
    delta = np.einsum("nij,nj->ni", np.where(np.isfinite(covariance), covariance, 0.0), g)
    explained = np.einsum("ni,ni->n", g, np.where(solvable, delta, 0.0))
    residual = np.maximum(reduced[:, 0, 0] - explained, 0.0)
    delta = np.where(solvable, delta, np.nan)
    return WindowSolution(delta, covariance, residual, explained, e0, H)


def _project(window: Summary, n: int) -> tuple[FloatArray, FloatArray]:
    """Return e0 (N, n) and the Gram of [e psi] at the best initial state with Gamma projected out (N, 1+q, 1+q)."""
    count, width = window.gram.shape[:2]
    root = pseudo_root(window.GG[:n, :n])
    blocks = window.moment.reshape(width, n, count, width)  # block, state, window, column
    e0 = row_products(row_products(blocks[0, :, :, 0].T, root), root.T)
    sign = np.ones(width)
    sign[0] = -1.0  # e loses Gamma e0, psi_i gains d_i Gamma e0
    # summed over the few states one by one, which a general contraction takes longer to plan than to do
    turned = blocks[:, 0] * e0[:, 0][None, :, None]
    for r in range(1, n):
        turned += blocks[:, r] * e0[:, r][None, :, None]
    moved = turned.transpose(1, 2, 0) * sign
    GG = window.GG.reshape(width, n, width, n)
    pairs = (e0[:, :, None] * e0[:, None, :]).reshape(count, n * n)
    kernel = (GG * np.outer(sign, sign)[:, None, :, None]).transpose(1, 3, 0, 2).reshape(n * n, width * width)
    gram = window.gram + moved + moved.transpose(0, 2, 1) + row_products(pairs, kernel).reshape(count, width, width)
    leverage = (GG[0] * sign[:, None]).transpose(2, 0, 1).reshape(n, n * width)
    P = blocks[0].transpose(1, 0, 2) + row_products(e0, leverage).reshape(count, n, width)
    Q = row_products(P.transpose(0, 2, 1).reshape(count * width, n), root).reshape(count, width, -1)
    return e0, gram - Q @ Q.transpose(0, 2, 1)


def _inverse(H: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Invert symmetric matrices (N, q, q) after scaling to unit diagonal; (N, q) False where nothing is known."""
    q = H.shape[1]
    diagonal = np.einsum("nii->ni", H)
    known = (diagonal > 0) & np.isfinite(diagonal)
    scale = np.where(known, 1.0 / np.sqrt(np.where(known, diagonal, 1.0)), 0.0)
    scaled = H * scale[:, :, None] * scale[:, None, :]
    filled = scaled + np.where(known, 0.0, 1.0)[:, :, None] * np.eye(q)
    filled = np.where(np.isfinite(filled), filled, np.eye(q))
    try:
        inverse = np.linalg.inv(filled)
    except np.linalg.LinAlgError:
        inverse = np.linalg.pinv(filled, hermitian=True)
    # variances below the scaled bound of 1 or negative are round-off: the matrix is singular to working precision
    variance = np.einsum("nii->ni", inverse)
    sound = known & np.all((variance >= 0.5) & (variance < 1e14), axis=1, keepdims=True)
    covariance = np.asarray(inverse * scale[:, :, None] * scale[:, None, :], dtype=np.float64)
    index = np.arange(q)
    covariance[:, index, index] = np.where(sound, covariance[:, index, index], np.inf)
    return covariance, sound
