"""Simulated histories whose truth is known: level, noise of the estimates, and when the limit is reached."""

import numpy as np

from agent.prognosis.history import History

LIMIT = 20.0


def straight(rng: np.random.Generator, n: int = 60) -> tuple[History, float]:
    """A level falling from 25 at a steady rate with Wiener noise; what remains until it first reaches 20."""
    q, s = np.exp(rng.uniform(np.log([0.02, 0.02]), np.log([0.15, 0.1]))) * np.array([0.5, 5.0])
    rate, dt = 0.05 * np.exp(rng.normal(0.0, 0.3)), 0.25
    t = np.arange(0.0, 1500.0, dt)
    level = 25.0 - rate * t + np.r_[0.0, np.cumsum(q * np.sqrt(dt) * rng.standard_normal(len(t) - 1))]
    life = float(t[np.flatnonzero(level <= LIMIT)[0]])
    at = np.linspace(0.0, rng.uniform(0.4, 0.8) * life, n)
    value = np.interp(at, t, level) + s * rng.standard_normal(n)
    return History(at, value, np.full(n, s)), life - float(at[-1])


def hardly_moved(rng: np.random.Generator, times: float = 10.0) -> tuple[History, float]:
    """The same, whose newest rows rest on little movement: their stated sd is so many times the others'."""
    history, remains = straight(rng)
    late = history.t > 0.85 * history.t[-1]
    sd = np.where(late, times, 1.0) * history.sd
    more = np.sqrt(sd**2 - history.sd**2) * rng.standard_normal(len(history))
    return History(history.t, history.value + more, sd), remains


def bent(rng: np.random.Generator, n: int = 120, noise: float = 0.05) -> History:
    """A level that falls faster and faster, days."""
    t = np.arange(float(n))
    return History(t, 25.0 - 0.01 * t - 1.5e-4 * t * t + noise * rng.standard_normal(n), np.full(n, noise))


def coloured(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """AR(1) of sd 1."""
    from scipy.signal import lfilter

    noise = rng.standard_normal(n + 1000)
    return np.sqrt(1.0 - rho * rho) * np.asarray(lfilter([1.0], [1.0, -rho], noise))[1000:]


def year(values: np.ndarray, sd: float = 0.3) -> History:
    return History(np.linspace(0.0, 365.0, len(values)), values, np.full(len(values), sd))
