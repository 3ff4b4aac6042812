"""What the healthy windows since the last change say together about theta: where to linearise.

A window with little information about one parameter must not throw theta_r about, so theta_r is the
information-weighted mean of disjoint windows with slow forgetting, and a window that contradicts it starts it anew.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

FloatArray = NDArray[np.float64]

FORGET = 0.95
"""Weight of the past at each disjoint window: a memory of about twenty windows."""


@dataclass(frozen=True, slots=True)
class Reference:
    """Accumulated information A (q, q) and A theta (q,), in units of the parameters' sizes."""

    A: FloatArray
    b: FloatArray

    @classmethod
    def empty(cls, q: int) -> "Reference":
        """Return the knowledge of nothing."""
        return cls(np.zeros((q, q)), np.zeros(q))

    def with_windows(self, information: FloatArray, theta: FloatArray) -> "tuple[FloatArray, FloatArray]":
        """Return A (N, q, q) and b (N, q) after each of N further disjoint windows, theta (N, q) scaled."""
        count, q = theta.shape
        pieces = np.concatenate([information, np.einsum("nij,nj->ni", information, theta)[:, None]], axis=1)
        kept = _forgetting(np.vstack([self.A, self.b]).ravel(), pieces.reshape(count, -1)).reshape(count, q + 1, q)
        return kept[:, :q], kept[:, q]


def _forgetting(before: FloatArray, pieces: FloatArray) -> FloatArray:
    """Add pieces (N, c) one after the other to what was before (c,) and fades; return it after each of them.

    In order, since a product of all at once would round differently for each number of them: forward substitution in
    the equations kept[i] - FORGET kept[i-1] = pieces[i] does that, one row after the other.
    """
    count = len(pieces) + 1
    bands = np.repeat([[1.0], [-FORGET]], count, axis=1)
    kept, _ = lapack.dtbtrs(bands, np.vstack([before, pieces]), uplo="L", diag="U")
    return np.asarray(kept[1:])


def mean_and_sd(A: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return means (N, q) and standard deviations (N, q) of accumulated information; sd inf where it says nothing."""
    diagonal = np.einsum("nii->ni", A)
    known = diagonal > 0
    ridge = np.where(known, 1e-12 * diagonal, 1.0)
    inverse = np.linalg.inv(A + ridge[:, :, None] * np.eye(A.shape[1]))
    sd = np.sqrt(np.maximum(np.einsum("nii->ni", inverse), 0.0))
    return np.einsum("nij,nj->ni", inverse, b), np.where(known, sd, np.inf)


def combined(reference: Reference, information: FloatArray, theta: FloatArray) -> tuple[FloatArray, Reference]:
    """Return where to linearise after a window's fit theta (q,) with information (q, q), and the new reference.

    The mean of both where they agree (chi-square of their difference under its mean plus five deviations), the
    window's own where they do not: then something changed, and the past is forgotten.
    """
    alone = Reference(information, information @ theta)
    q = len(theta)
    mean, sd = mean_and_sd(reference.A[None], reference.b[None])
    if not np.all(np.isfinite(sd)):
        return theta, alone
    difference = theta - mean[0]
    both = reference.A + information
    # (A^-1 + H^-1)^-1 = A (A + H)^-1 H
    chi2 = float(difference @ reference.A @ np.linalg.lstsq(both, information @ difference, rcond=1e-14)[0])
    if chi2 > q + 5 * np.sqrt(2 * q):
        return theta, alone
    total = Reference(both, reference.b + alone.b)
    return mean_and_sd(total.A[None], total.b[None])[0][0], total
