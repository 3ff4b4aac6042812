"""Normal operation of the rig without end: drives of changing level, load changes, bursts and standstills.

Phases of 5 to 40 s follow each other at random. A drive is a random force (white, 5 N rms; a force that is measured
and excites both modes) of 80, 100 or 120 % about a mean load; a burst is half a second to two seconds of one and a
half times the force; a load change moves the mean at once; at a standstill there is no force and the motion dies out.
"""

from dataclasses import dataclass

import numpy as np

from agent.types import FloatArray
from tests.statistical.machine import SECOND, Machine, on_second

DRIVE_N = 5.0
LEVELS = (0.8, 1.0, 1.2)
LOADS_N = (-0.1, -0.05, 0.0, 0.05, 0.1)
BURST = 1.5
KINDS = ("drive", "load", "burst", "standstill")
ODDS = (0.35, 0.3, 0.2, 0.15)
FULL_SCALE_M = 0.08
"""The largest displacement in healthy operation stays below this; the tests hold it to the days they play."""
NOISE_M = 1e-3 * FULL_SCALE_M


@dataclass(slots=True)
class Operation:
    """The rig at work, drawn from rng; `peak` is the largest displacement so far, m."""

    rng: np.random.Generator
    machine: Machine
    peak: float = 0.0
    _level: float = 1.0
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
        return force[:-1], y + NOISE_M * self.rng.standard_normal(y.shape)

    def _force(self, kind: str, samples: int) -> FloatArray:
        if kind == "standstill":
            return np.zeros(samples)
        self._level = float(self.rng.choice(LEVELS))
        level = np.full(samples, self._level * DRIVE_N)
        load = np.full(samples, self._load)
        if kind == "burst":
            start = int(self.rng.integers(0, samples - 2 * SECOND))
            level[start : start + int(self.rng.integers(SECOND // 2, 2 * SECOND))] *= BURST
        if kind == "load":
            start, self._load = int(self.rng.integers(0, samples)), float(self.rng.choice(LOADS_N))
            load[start:] = self._load
        return load + level * self.rng.standard_normal(samples)
