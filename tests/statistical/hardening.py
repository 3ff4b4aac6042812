"""Chains whose springs harden or soften: k e (1 + share (e / rms)²) at the extension e, by Runge-Kutta."""

from collections.abc import Sequence

import numpy as np

from agent.types import FloatArray
from tests.statistical.chains import Chain


def motion(
    chain: Chain, forces: FloatArray, shares: Sequence[float], masses: Sequence[float] = ()
) -> FloatArray:
    """Displacements (N, masses) under forces (N, masses) that run straight between samples, from rest.

    shares: by which each spring is stiffer at its extension's rms, as it would be were all straight.
    """
    m, k, b = (np.array(each) for each in (masses or chain.masses, chain.springs, chain.dampers))
    straight = _displacements(chain, forces)
    bend = k * np.array(shares) / (np.diff(straight, axis=1, prepend=0.0) ** 2).mean(axis=0)
    h = 1.0 / chain.rate_hz
    # each spring and damper pulls its mass back and the mass before it forth
    across = np.eye(len(m)) - np.eye(len(m), k=-1)

    def speeds(state: FloatArray, force: FloatArray) -> FloatArray:
        e, de = state @ across.T
        pull = k * e + bend * e**3 + b * de
        return np.array([state[1], (force - pull @ across) / m])

    state, seen = np.zeros((2, len(m))), np.zeros_like(forces)
    for i, (force, later) in enumerate(zip(forces, [*forces[1:], forces[-1]], strict=True)):
        seen[i] = state[0]
        middle = 0.5 * (force + later)
        first = speeds(state, force)
        second = speeds(state + 0.5 * h * first, middle)
        third = speeds(state + 0.5 * h * second, middle)
        state = state + h / 6 * (first + 2 * second + 2 * third + speeds(state + h * third, later))
    return seen


def _displacements(chain: Chain, forces: FloatArray) -> FloatArray:
    sensors = tuple(("displacement", i) for i in range(len(chain.masses)))
    all_seen = Chain(
        chain.masses, chain.springs, chain.dampers, chain.rate_hz, sensors, (0.0,) * len(chain.masses)
    )
    return all_seen.motion(forces)
