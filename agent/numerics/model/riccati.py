"""The steady state of a Kalman predictor by structured doubling: no Schur form to reorder, about 20 steps, always ends.

x(k+1) = A x(k) + w(k), y(k) = C x(k) + v(k), cov (w, v) = diag(Q, R). One step of doubling takes the covariance of a
prediction over N samples to that over 2 N (Anderson & Moore, Optimal Filtering, 1979, section 6.7; Chu, Fan & Lin, Int.
J. Control 77 (2004) 767). Poles next to the unit circle cost some steps more and no more than that, where a solver by
invariant subspaces must tell eigenvalues inside it from those outside and gives up.

Outputs are taken in units of their own noise and states in units of what the readings show of them, so that sensors of
different kinds and masses of different size weigh alike.
"""

import numpy as np

from agent.types import FloatArray

MOST_STEPS = 60
"""Doublings: 2^60 samples are more than any rig will see."""
SETTLED = 1e-14
"""Relative change of the covariance at which it has settled."""
LOOKS = 6
"""Doublings over which the readings show the states: 64 samples."""


def steady_covariance(A: FloatArray, C: FloatArray, process: FloatArray) -> FloatArray | None:
    """Return the covariance (n, n) of the predicted state for sensor noise of covariance 1; None where it has none.

    Args:
        A: (n, n) the sampled model.
        C: (p, n) its outputs, each in units of its noise.
        process: (n, n) covariance of the process noise a sample.

    What is returned solves the Riccati equation; whether its gain stabilises is the caller's to see.
    """
    with np.errstate(all="ignore"):  # what is no number is looked at below
        units = state_units(A, C)
        scaled = A * units[:, None] / units
        H = _settled(scaled.T, C / units, process * np.outer(units, units))
        P = None if H is None else H / np.outer(units, units)
    return P if P is not None and np.all(np.isfinite(P)) else None


def state_units(A: FloatArray, C: FloatArray) -> FloatArray:
    """Return (n,) how much some samples of readings C (p, n) show of each state: the diagonal of a Gramian, rooted."""
    information, step = C.T @ C, A
    for _ in range(LOOKS):
        grown = information + step.T @ information @ step
        if not np.all(np.isfinite(grown)):
            break
        information, step = grown, step @ step
    shown = np.sqrt(np.maximum(np.diag(information), 0.0))
    greatest = float(shown.max(initial=0.0))
    return np.where(shown > 0, shown, greatest if greatest > 0 else 1.0)


def _settled(a: FloatArray, C: FloatArray, H: FloatArray) -> FloatArray | None:
    """Double until the covariance H settles; a is A transposed."""
    G = C.T @ C
    for _ in range(MOST_STEPS):
        before = H
        try:
            joined = np.linalg.solve(np.eye(len(a)) + G @ H, np.hstack([a, G @ a.T]))
        except np.linalg.LinAlgError:
            return None
        left, right = joined[:, : len(a)], joined[:, len(a) :]
        H, G, a = _symmetric(H + a.T @ H @ left), _symmetric(G + a @ right), a @ left
        size = float(np.linalg.norm(H))
        if not np.isfinite(size):
            return None
        if np.linalg.norm(H - before) <= SETTLED * size:
            return H
    return None


def _symmetric(M: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (M + M.T))
