"""A Kalman predictor's steady state by structured doubling: no Schur reordering, about 20 steps, always ends.

x(k+1) = A x(k) + w(k), y(k) = C x(k) + v(k), cov (w, v) = [[Q, S], [S', R]]. With a = (A − S R⁻¹ C)', G = C'
R⁻¹ C and H = Q − S R⁻¹ S' one step takes the covariance of a prediction over N samples to that over 2 N

    a <- a (I + G H)⁻¹ a,   G <- G + a (I + G H)⁻¹ G a',   H <- H + a' H (I + G H)⁻¹ a

and H tends to it (Anderson & Moore, Optimal Filtering, 1979, section 6.7; Chu, Fan & Lin, Int. J. Control 77
(2004) 767). Poles next to the unit circle cost some steps more and no more than that, where a solver by
invariant subspaces must tell eigenvalues inside it from those outside and gives up.

States are taken in units of what the readings show of them, so that masses of different size weigh alike.
"""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.tuning import LOOKS, MOST_STEPS, REMEMBERED, SETTLED, UNSHOWN
from agent.types import FloatArray


class NoSteadyStateError(ArithmeticError):
    """The predictor of this model and noise has no stable steady state; more process noise makes one."""


@dataclass(frozen=True, slots=True)
class Predictor:
    """x̂(k+1) = A x̂ + B u + K (y − C x̂ − D u) in its steady state.

    Attributes:
        K: (n, p) gain.
        S: (p, p) covariance of the innovations.
        P: (n, n) covariance of x − x̂.
    """

    K: FloatArray
    S: FloatArray
    P: FloatArray


def steady_predictor(A: FloatArray, C: FloatArray, Q: FloatArray, R: FloatArray, S: FloatArray) -> Predictor:
    """Return the steady predictor for process noise Q (n, n), sensor noise R (p, p), correlated by S (n, p).

    Raises NoSteadyStateError where what it settles to (or does not) is no stable predictor.
    """
    correction = np.linalg.solve(R, S.T).T
    decoupled = A - correction @ C
    P, _ = _doubled(decoupled, C.T @ np.linalg.solve(R, C), _symmetric(Q - correction @ S.T), UNSHOWN)
    innovation = _symmetric(C @ P @ C.T + R)
    K = np.asarray(np.linalg.solve(innovation, (A @ P @ C.T + S).T).T, dtype=np.float64)
    if not np.isfinite(K).all() or spectral_radius(A - K @ C) > 1 - REMEMBERED:
        raise NoSteadyStateError("no stable predictor: a state that does not decay has no process noise")
    return Predictor(K, innovation, P)


def steady_covariance(A: FloatArray, C: FloatArray, process: FloatArray) -> FloatArray | None:
    """Return the predicted state's covariance (n, n) for sensor noise of covariance 1; None if it has none.

    Args:
        A: (n, n) the sampled model.
        C: (p, n) its outputs, each in units of its noise.
        process: (n, n) covariance of the process noise a sample.

    What is returned solves the Riccati equation; whether its gain stabilises is the caller's to see.
    """
    with np.errstate(all="ignore"):  # what is no number is looked at below
        try:
            P, settled = _doubled(A, C.T @ C, process, 0.0)
        except np.linalg.LinAlgError:
            return None
    return P if settled and np.all(np.isfinite(P)) else None


def spectral_radius(A: FloatArray) -> float:
    """Return the largest modulus of A's eigenvalues."""
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def state_units(A: FloatArray, C: FloatArray) -> FloatArray:
    """Return (n,) how much some samples of readings C (p, n) show each state: root of a Gramian diagonal."""
    return _units(A, C.T @ C, 0.0)


def _units(A: FloatArray, information: FloatArray, least: float) -> FloatArray:
    step = A
    for _ in range(LOOKS):
        grown = information + step.T @ information @ step
        if not np.all(np.isfinite(grown)):
            break
        information, step = grown, step @ step
    shown = np.sqrt(np.maximum(np.diag(information), 0.0))
    greatest = float(shown.max(initial=0.0))
    return np.where(shown > least * greatest, shown, greatest if greatest > 0 else 1.0)


def _doubled(A: FloatArray, information: FloatArray, Q: FloatArray, least: float) -> tuple[FloatArray, bool]:
    """Return the covariance (n, n) that doubling ends at, and whether it has settled there."""
    unit = _units(A, information, least)
    both = np.outer(unit, unit)
    a = (A * unit[:, None] / unit).T
    G = information / both
    H = Q * both
    for _ in range(MOST_STEPS):
        joined = np.linalg.solve(np.eye(len(a)) + G @ H, np.hstack([a, G @ a.T]))
        left, right, before = joined[:, : len(a)], joined[:, len(a) :], H
        H, G, a = _symmetric(H + a.T @ H @ left), _symmetric(G + a @ right), a @ left
        size = float(np.linalg.norm(H))
        if not np.isfinite(size):
            break
        if np.linalg.norm(H - before) <= SETTLED * size:
            return H / both, True
    return H / both, False


def _symmetric(M: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (M + M.T))
