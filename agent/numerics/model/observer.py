"""Observer gains and observability.

The observer is the paper's (2): x(k+1) = A x + B u + L (y - C x - D u), with L its K_e.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from agent.numerics.model.statespace import Discrete, StateSpace

FloatArray = NDArray[np.float64]

STRICTLY_STABLE = 1.0 - 1e-6
"""Largest pole radius with which an observer may run on without correction (gain zero)."""


def spectral_radius(A: FloatArray) -> float:
    """Return the largest magnitude of the eigenvalues of A."""
    return float(np.max(np.abs(np.linalg.eigvals(A)), initial=0.0))


def poles_gain(model: StateSpace, poles: Sequence[complex], period_s: float) -> FloatArray:
    """Return L (n, p) that puts the observer's poles at exp(s T) for each continuous pole s (1/s).

    Raises ValueError when there are not n poles or they cannot be placed.
    """
    from scipy.signal import place_poles  # 0.7 s to import, and few configurations ask for it

    if len(poles) != model.n:
        raise ValueError(f"{len(poles)} poles for {model.n} states; give {model.n}")
    placed = np.exp(np.asarray(poles) * period_s)
    return np.ascontiguousarray(place_poles(model.A.T, model.C.T, placed).gain_matrix.T)


def kalman_gain(model: StateSpace, process: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the steady-state predictor gain L = A P C' S^-1, (n, p), and the innovations' S = C P C' + R, (p, p).

    Args:
        model: the sampled model.
        process: (n, n) covariance of the process noise a sample.
        noise: (p, p) covariance R of the sensor noise.

    Raises ValueError when the Riccati equation has no stabilising solution.
    """
    try:
        P = solve_discrete_are(model.A.T, model.C.T, process, noise)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ValueError(f"no stabilising observer gain: {error}") from error
    S = model.C @ P @ model.C.T + noise
    L = np.linalg.solve(S, model.C @ P @ model.A.T).T
    if not spectral_radius(model.A - L @ model.C) < 1.0:
        raise ValueError("no stabilising observer gain: the outputs do not show a mode that does not decay")
    return np.asarray(L, dtype=np.float64), np.asarray(S, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Noise:
    """The disturbances of a rig.

    Attributes:
        sigma: (p,) standard deviation of each output's white noise.
        process: (d,) standard deviation of the unknown force in each direction, constant over a sample, white.
    """

    sigma: FloatArray
    process: FloatArray

    @property
    def forced(self) -> bool:
        """Whether any unknown force is assumed."""
        return bool(np.any(self.process > 0))


@dataclass(frozen=True, slots=True)
class Gain:
    """An observer gain L (n, p) and the whitening (p, p) that makes its innovations unit noise."""

    L: FloatArray
    whitening: FloatArray


def plain_gain(L: FloatArray, sigma: FloatArray) -> Gain:
    """Return a gain whose innovations are weighed by the sensors' noise alone."""
    return Gain(L, np.diag(1.0 / sigma))


def matched_gain(discrete: Discrete, disturbance: FloatArray, noise: Noise) -> Gain:
    """Return the steady-state Kalman gain of a rig's disturbances and the whitening of its innovations.

    Args:
        discrete: the sampled model.
        disturbance: (n, d) how a force in each direction pushes the state, a second.
        noise: the disturbances.

    Raises ValueError when the Riccati equation has no stabilising solution.
    """
    model = discrete.model
    # in units of the sensors' noise, which keeps the Riccati equation well conditioned
    unit = float(np.sqrt(np.mean(noise.sigma**2)))
    push = disturbance * noise.process * discrete.period_s / unit
    R = np.diag((noise.sigma / unit) ** 2)
    L, S = kalman_gain(model, push @ push.T, R)
    whitening = np.linalg.inv(np.linalg.cholesky(0.5 * (S + S.T))) / unit
    return Gain(L, np.asarray(whitening, dtype=np.float64))


def start_gain(discrete: Discrete, disturbance: FloatArray, sigma: FloatArray, window: int) -> FloatArray:
    """Return a Kalman gain whose slowest pole forgets within a window, for use before the first fit.

    Args:
        discrete: the sampled model.
        disturbance: (n, d) directions in which unknown forces push the state.
        sigma: (p,) standard deviation of each output's noise.
        window: samples in the window.

    The one free figure, the intensity of the disturbance, is searched by bisection of its logarithm.
    Raises ValueError when no intensity gives a stable observer.
    """
    strength = np.ones(disturbance.shape[1])
    unit = float(np.sqrt(np.mean(sigma**2)) / max(np.linalg.norm(disturbance) * discrete.period_s, 1e-300))
    target = np.exp(-6.0 / window)
    low, high = -4.0, 8.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        if _forgets(discrete, disturbance, Noise(sigma, 10.0**middle * unit * strength), target):
            high = middle
        else:
            low = middle
    return matched_gain(discrete, disturbance, Noise(sigma, 10.0**high * unit * strength)).L


def _forgets(discrete: Discrete, disturbance: FloatArray, noise: Noise, target: float) -> bool:
    """Tell whether the matched gain exists and puts every pole inside the radius `target`."""
    try:
        gain = matched_gain(discrete, disturbance, noise).L
    except ValueError:
        return False
    return spectral_radius(discrete.model.A - gain @ discrete.model.C) < target


def unobservable_states(continuous: StateSpace, names: Sequence[str], tolerance: float = 1e-9) -> list[str]:
    """Return the names of states that the outputs do not show; empty when (A, C) is observable.

    The hidden states are the largest subspace of the kernel of C that A does not leave, found by orthogonal steps: a
    test at each eigenvalue would miss the double pole at zero of a free rig, which is computed to 1e-8 only. Time is
    scaled so that the fastest mode is 1, states are balanced and rows of C scaled to 1, so that units do not decide.
    """
    speed = max(float(np.max(np.abs(np.linalg.eigvals(continuous.A)), initial=0.0)), 1e-300)
    A, scale = _balanced(continuous.A / speed)
    C = continuous.C * scale
    norms = np.linalg.norm(C, axis=1, keepdims=True)
    hidden = _kernel(C / np.where(norms > 0, norms, 1.0), tolerance)
    while hidden.shape[1]:
        moved = A @ hidden
        staying = _kernel(moved - hidden @ (hidden.T @ moved), tolerance)
        if staying.shape[1] == hidden.shape[1]:
            break
        hidden = hidden @ staying
    return [name for name, row in zip(names, hidden, strict=True) if np.linalg.norm(row) > 1e-3]


def _kernel(matrix: FloatArray, tolerance: float) -> FloatArray:
    """Return an orthonormal basis (columns) of what a matrix of size about 1 takes to nearly nothing."""
    _, values, vectors = np.linalg.svd(matrix)
    rank = int((values > tolerance).sum())
    return np.asarray(vectors[rank:].T, dtype=np.float64)


def _balanced(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A scaled by a diagonal similarity so that rows and columns weigh alike, and the (n,) scaling of C."""
    from scipy.linalg import matrix_balance

    balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(balanced, dtype=np.float64), np.asarray(scale, dtype=np.float64)
