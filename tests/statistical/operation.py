"""Normal operation of the rig without end: drives of changing level, load changes, bursts and standstills.

The force is measured and excites both modes: two turning parts and a random load. Phases of 5 to 40 s follow
each other at random: a drive at 80, 100 or 120 %; a load change, which moves the mean force at once; a burst,
half a second to two seconds with twice the random load; a standstill without force, where the motion dies
out.
"""

from dataclasses import dataclass

import numpy as np

from agent.types import FloatArray
from tests.statistical.machine import PERIOD, SECOND, Machine, on_second

TURNS_HZ, TURNS_N = (0.4, 1.3), (0.4, 0.6)
RANDOM_N = 2.0
LEVELS = (0.8, 1.0, 1.2)
LOADS_N = (-0.1, -0.05, 0.0, 0.05, 0.1)
BURST = 2.0
KINDS = ("drive", "load", "burst", "standstill")
ODDS = (0.35, 0.3, 0.2, 0.15)
FULL_SCALE_M = 0.07
"""Where the displacement sensors end; healthy operation stays within for weeks, then may touch it."""
NOISE_M = 1e-3 * FULL_SCALE_M


def drive(rng: np.random.Generator, samples: int, random_n: FloatArray | float = RANDOM_N) -> FloatArray:
    """Return the force (samples,) of turning parts, at angles of their own, and of the random load."""
    t = PERIOD * np.arange(samples)
    force = random_n * rng.standard_normal(samples)
    for frequency, amplitude in zip(TURNS_HZ, TURNS_N, strict=True):
        force += amplitude * np.sin(2.0 * np.pi * (frequency * t + rng.random()))
    return np.asarray(force)


@dataclass(slots=True)
class Operation:
    """The rig at work, drawn from rng; `peak` is the largest displacement so far, m."""

    rng: np.random.Generator
    machine: Machine
    peak: float = 0.0
    _load: float = 0.0
    _last: float = 0.0

    def phase(self) -> tuple[FloatArray, FloatArray]:
        """Return measured force (N,) and measured displacements (N, 2) of the next phase."""
        samples = int(self.rng.integers(5 * SECOND, 40 * SECOND))
        force = self._force(str(self.rng.choice(KINDS, p=ODDS)), samples)
        force = np.concatenate([[self._last], force])
        self._last = float(force[-1])
        y = self.machine.play(on_second(force))[:, :2]
        self.peak = max(self.peak, float(np.abs(y).max()))
        return force[:-1], (y + NOISE_M * self.rng.standard_normal(y.shape)).clip(-FULL_SCALE_M, FULL_SCALE_M)

    def _force(self, kind: str, samples: int) -> FloatArray:
        if kind == "standstill":
            return np.zeros(samples)
        random_n, load = np.full(samples, RANDOM_N), np.full(samples, self._load)
        if kind == "burst":
            start = int(self.rng.integers(0, samples - 2 * SECOND))
            random_n[start : start + int(self.rng.integers(SECOND // 2, 2 * SECOND))] *= BURST
        if kind == "load":
            start, self._load = int(self.rng.integers(0, samples)), float(self.rng.choice(LOADS_N))
            load[start:] = self._load
        return load + float(self.rng.choice(LEVELS)) * drive(self.rng, samples, random_n)
