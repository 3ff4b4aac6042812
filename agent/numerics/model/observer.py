"""Observer gains and observability.

The observer is the paper's (2): x(k+1) = A x + B u + L (y - C x - D u), with L its K_e.
"""

from collections.abc import Sequence

import numpy as np

from agent.numerics.model.riccati import spectral_radius, state_units, steady_covariance
from agent.numerics.model.statespace import Discrete, StateSpace
from agent.numerics.model.tuning import BISECTIONS, STRIDE, STRONGEST, WEAKEST
from agent.types import FloatArray

NO_GAIN = "no stabilising observer gain: the outputs do not show a mode that does not decay"


def poles_gain(
    model: StateSpace, poles: Sequence[complex], period_s: float, outputs: Sequence[int] | None = None
) -> FloatArray:
    """Return L (n, p) that puts the observer's poles at exp(s T) for each continuous pole s (1/s).

    outputs: numbers of those that the observer corrects itself by; None for all of them.

    Raises ValueError when there are not n poles or they cannot be placed.
    """
    from scipy.signal import place_poles  # 0.7 s to import, and few configurations ask for it

    if len(poles) != model.n:
        raise ValueError(f"{len(poles)} poles for {model.n} states; give {model.n}")
    placed = np.exp(np.asarray(poles) * period_s)
    rows = list(range(model.p) if outputs is None else outputs)
    gain = np.zeros((model.n, model.p))
    gain[:, rows] = place_poles(model.A.T, model.C[rows].T, placed).gain_matrix.T
    return gain


def _unit_gain(A: FloatArray, C: FloatArray, process: FloatArray) -> FloatArray:
    """Return L (n, p) for outputs C (p, n) of any kind, in units of their own noise."""
    P = steady_covariance(A, C, process)
    if P is None:
        raise ValueError(NO_GAIN)
    S = C @ P @ C.T + np.eye(len(C))
    L = np.linalg.solve(S, C @ P @ A.T).T
    if not (np.all(np.isfinite(L)) and spectral_radius(A - L @ C) < 1.0):
        raise ValueError(NO_GAIN)
    return np.asarray(L, dtype=np.float64)


def matched_gain(
    discrete: Discrete, disturbance: FloatArray, sigma: FloatArray, process: FloatArray
) -> FloatArray:
    """Return the steady-state Kalman gain L (n, p) of a rig's disturbances.

    Args:
        discrete: the sampled model.
        disturbance: (n, d) how a force in each direction pushes the state, a second.
        sigma: (p,) standard deviation of each output's white noise.
        process: (d,) standard deviation of the unknown force in each direction, constant over a sample,
            white.

    Raises ValueError when the Riccati equation has no stabilising solution.
    """
    push = disturbance * process * discrete.period_s
    C = discrete.model.C / sigma[:, None]
    with np.errstate(
        over="ignore", invalid="ignore"
    ):  # a force beyond all numbers has no gain, which is said below
        return _unit_gain(discrete.model.A, C, push @ push.T) / sigma


def start_gain(discrete: Discrete, disturbance: FloatArray, sigma: FloatArray, window: int) -> FloatArray:
    """Return a Kalman gain whose slowest pole forgets within a window, for use before the first fit.

    Args:
        discrete: the sampled model.
        disturbance: (n, d) directions in which unknown forces push the state.
        sigma: (p,) standard deviation of each output's noise.
        window: samples in the window.

    The one free figure, the intensity of the disturbance, is the least that forgets so soon. Where none does
    (an accelerometer's zeros are slow) it is the one that forgets soonest; where forces alone give no stable
    observer, every state is pushed. Raises ValueError when no intensity gives a stable observer.
    """
    units = state_units(discrete.model.A, discrete.model.C / sigma[:, None])
    for pushes in (disturbance, np.diag(1.0 / units)):
        found = _searched(discrete, pushes, units, sigma, float(np.exp(-6.0 / window)))
        if found is not None:
            return found
    raise ValueError(NO_GAIN)


def _searched(
    discrete: Discrete, pushes: FloatArray, units: FloatArray, sigma: FloatArray, target: float
) -> FloatArray | None:
    """Return the weakest gain whose poles lie within the radius `target`, else that of the least radius."""
    unit = 1.0 / max(float(np.linalg.norm(units[:, None] * pushes)) * discrete.period_s, 1e-300)
    trials: dict[float, tuple[float, FloatArray | None]] = {}

    def forgets(exponent: float) -> bool:
        process = np.full(pushes.shape[1], 10.0**exponent * unit)
        trials[exponent] = _tried(discrete, pushes, sigma, process)
        return trials[exponent][0] < target

    exponents = np.arange(WEAKEST, STRONGEST + STRIDE, STRIDE).tolist()
    high = next((exponent for exponent in exponents if forgets(exponent)), None)
    if high is None:
        return min(trials.values(), key=lambda trial: trial[0])[1]
    low = high - STRIDE
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if forgets(middle) else (middle, high)
    return trials[high][1]


def _tried(
    discrete: Discrete, pushes: FloatArray, sigma: FloatArray, process: FloatArray
) -> tuple[float, FloatArray | None]:
    """Return the observer's spectral radius with the matched gain, and the gain; inf and None without one."""
    try:
        gain = matched_gain(discrete, pushes, sigma, process)
    except ValueError:
        return np.inf, None
    return spectral_radius(discrete.model.A - gain @ discrete.model.C), gain


def unobservable_states(continuous: StateSpace, names: Sequence[str], tolerance: float = 1e-9) -> list[str]:
    """Return the names of states that the outputs do not show; empty when (A, C) is observable.

    The hidden states are the largest subspace of the kernel of C that A does not leave, found by orthogonal
    steps: a test at each eigenvalue would miss the double pole at zero of a free rig, which is computed to
    1e-8 only. Time is scaled so that the fastest mode is 1, states are balanced and rows of C scaled to 1, so
    that units do not decide. In discrete time A - I takes the place of A: it hides the same states and tells
    slow modes from one another.
    """
    rates = continuous.A - np.eye(continuous.n) if continuous.is_sampled else continuous.A
    speed = max(float(np.max(np.abs(np.linalg.eigvals(rates)), initial=0.0)), 1e-300)
    A, scale = balanced(rates / speed)
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


def balanced(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return A (n, n) scaled by a diagonal similarity so that rows and columns weigh alike, and the scale."""
    from scipy.linalg.lapack import dgebal  # scipy's matrix_balance imports masked arrays, which take 1 MB

    alike, _, _, scale, _ = dgebal(A, scale=1, permute=0)
    return np.asarray(alike), np.asarray(scale)
