"""Fisher information of a window and the Cramer-Rao bound: the least sd that any unbiased estimate can have.

White sensor noise of known standard deviation, an unknown initial state, a known input (Ljung, System Identification,
2nd ed. 1999, section 7.4).
"""

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import linearised
from agent.numerics.fitting.window_filter import WindowFilter
from agent.numerics.model.observer import plain_gain
from agent.numerics.model.statespace import Discrete, simulate

FloatArray = NDArray[np.float64]


def information_filter(discrete: Discrete, sigma: FloatArray, window: int) -> WindowFilter:
    """Return what `window_information` runs over a window; built once, it serves every window of a model and noise."""
    model = discrete.model
    return WindowFilter(model, plain_gain(np.zeros((model.n, model.p)), sigma), window)


def window_information(
    discrete: Discrete, x0: FloatArray, u: FloatArray, sigma: FloatArray, filters: WindowFilter | None = None
) -> FloatArray:
    """Return the Fisher information (q, q) of a window's parameters, the initial state projected out.

    Args:
        discrete: the sampled model at the true parameters.
        x0: (n,) the physical state at the window's first sample.
        u: (W, m) inputs.
        sigma: (p,) standard deviation of each output's noise.
        filters: of `information_filter`, where there are several windows.
    """
    _, y = simulate(discrete, x0, u)
    shifted = x0 - discrete.B1 @ u[0]
    filters = filters or information_filter(discrete, sigma, len(u))
    window = linearised(filters, np.hstack([y, u]), shifted)
    return window.psi.T @ window.psi


def bound_sd(information: FloatArray) -> FloatArray:
    """Return the Cramer-Rao standard deviations (q,) of an information matrix; inf where it says nothing."""
    diagonal = np.diag(information)
    if not np.all(diagonal > 0):
        return np.full(len(diagonal), np.inf)
    scale = 1.0 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    if values[0] <= 1e-14 * values[-1]:
        return np.full(len(diagonal), np.inf)
    return np.asarray(scale * np.sqrt(np.sum(vectors**2 / values, axis=1)))


def expected_sd(
    discrete: Discrete, force_rms: FloatArray, sigma: FloatArray, window: int, seed: int = 0, windows: int = 8
) -> FloatArray:
    """Return the sd (q,) to expect of a window under white force: the rms of the bound over several windows.

    Args:
        discrete: the sampled model.
        force_rms: (m,) rms of each input.
        sigma: (p,) standard deviation of each output's noise.
        window: samples.
        seed: of the excitation drawn.
        windows: how many windows to average over.
    """
    rng = np.random.default_rng(seed)
    settle = min(20 * window, 20_000)
    x = np.zeros(discrete.model.n)
    u = rng.standard_normal((settle, len(force_rms))) * force_rms
    states, _ = simulate(discrete, x, u)
    bounds = []
    for _ in range(windows):
        start = int(rng.integers(settle // 2, max(settle - window, settle // 2 + 1)))
        u_window = u[start : start + window]
        if len(u_window) == window:
            bounds.append(bound_sd(window_information(discrete, states[start], u_window, sigma)))
    return np.asarray(np.sqrt(np.mean(np.square(bounds), axis=0)))
