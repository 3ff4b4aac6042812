"""Small dense algebra with columns of very different size: everything is scaled to unit diagonals first."""

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtri

from agent.numerics.inference.tuning import JITTER
from agent.types import FloatArray


def scales(M: FloatArray) -> FloatArray:
    """Return 1/√diag(M) (..., k), 1 where the diagonal is not positive."""
    diagonal = M.diagonal(axis1=-2, axis2=-1)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))


def _raised(M: FloatArray, d: FloatArray) -> FloatArray:
    """Return M (..., k, k) in units 1/d (..., k), its diagonal raised by the jitter."""
    scaled = M * d[..., :, None]
    scaled *= d[..., None, :]
    np.einsum("...ii->...i", scaled)[...] += JITTER
    return scaled


def inverse(M: FloatArray) -> FloatArray:
    """Return the inverse of symmetric positive M (..., k, k): a square, so its diagonal is never negative."""
    half = inverse_root(M)
    return np.asarray(half.swapaxes(-1, -2) @ half)


def inverse_root(M: FloatArray) -> FloatArray:
    """Return triangular H (..., k, k) with Hᵀ H = M⁻¹ of symmetric positive M (..., k, k).

    Where rounding left M indefinite, eigenvalues below the jitter are raised to it.
    """
    d = scales(M)
    return np.asarray(_inverse_root(_raised(M, d)) * d[..., None, :])


def _inverse_root(M: FloatArray) -> FloatArray:
    if M.ndim == 2 and len(M):
        # LAPACK at once: numpy's way there takes longer than matrices so small do
        factor, failed = dpotrf(M, lower=1, clean=1)
        if not failed:
            return np.asarray(dtrtri(factor, lower=1)[0])
    try:
        return _inverse_of_triangle(np.asarray(np.linalg.cholesky(M)))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(M)
        half = vectors.swapaxes(-1, -2) / np.sqrt(np.maximum(values, JITTER))[..., :, None]
        return np.asarray(np.linalg.qr(half, mode="r"))


def _inverse_of_triangle(L: FloatArray) -> FloatArray:
    """Return the inverses of lower triangles L (g, k, k), a row of all or a whole one at a time."""
    out = np.zeros_like(L)
    if len(L) <= L.shape[-1]:
        for found, one in zip(out, L, strict=True):
            found[:] = dtrtri(one, lower=1)[0]
        return out
    for i in range(L.shape[-1]):
        out[:, i, i] = 1.0
        out[:, i, :i] = -(L[:, i, None, :i] @ out[:, :i, :i])[:, 0]
        out[:, i, : i + 1] /= L[:, i, i, None]
    return out


def root(P: FloatArray) -> FloatArray:
    """Return F (..., k, k) with F Fᵀ = P of symmetric P (..., k, k); eigenvalues rounded below 0 become 0."""
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError:
        d = scales(P)
        values, vectors = np.linalg.eigh(P * d[..., :, None] * d[..., None, :])
        return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :] / d[..., :, None])


def shown(S: FloatArray, g: FloatArray, whole: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return information S (k, k) and score g (k,) left of whole (k,), directions of mere rounding at 0."""
    d = np.where(whole > 0, 1.0 / np.sqrt(np.where(whole > 0, whole, 1.0)), 0.0)
    values, vectors = np.linalg.eigh(S * np.outer(d, d))
    kept = vectors[:, values > JITTER]
    back = np.where(d > 0, 1.0 / np.where(d > 0, d, 1.0), 0.0)[:, None] * kept
    along = kept.T * d
    return np.asarray(back @ (along @ S @ along.T) @ back.T), np.asarray(back @ (along @ g))


def refined(M: FloatArray, V: FloatArray, rest: FloatArray) -> FloatArray:
    """Return M⁻¹ rest for M (k, k), V its `inverse`, rest (k,) or (k, r), with one iterative refinement step.

    Where directions are nearly alike V is right to few digits (Golub & Van Loan, Matrix Computations, 3.5.3).
    """
    first = V @ rest
    return np.asarray(first + V @ (rest - M @ first))


def log_determinant(M: FloatArray) -> FloatArray:
    """Return log det of symmetric positive M (..., k, k)."""
    d = scales(M)
    return np.asarray(np.linalg.slogdet(_raised(M, d))[1] - 2 * np.log(d).sum(axis=-1))


def quadratic(J: FloatArray, g: FloatArray, tolerance: float = 1e-10) -> FloatArray:
    """Return gᵀ J⁺ g (j,) for symmetric J (j, k, k), directions below `tolerance` of the largest left out."""
    d = scales(J)
    values, vectors = np.linalg.eigh(J * d[:, :, None] * d[:, None, :])
    kept = values > tolerance * np.maximum(values[:, -1:], 0.0)
    along = (vectors.swapaxes(1, 2) @ (d * g)[..., None])[..., 0]
    return np.asarray((along**2 / np.where(kept, values, np.inf)).sum(axis=1))
