"""What moves parameters besides a schedule: wear that wanders, and the temperature of the day.

Both add to what the schedule says, in steps of `every_s`, exact to the sample.
"""

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from sim_bus.rig.schedule import first_sample


class Wear(BaseModel):
    """One [[wear]]: how the named parameters move from `from_s` to `until_s`; then they stay where they are.

    walk: a random walk; `rate` is its standard deviation after a second, in the parameter's unit.
    temperature: a sine of `amplitude` degrees and `period_s`; `rate` is what a degree does, in the
    parameter's unit.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["walk", "temperature"]
    rate: dict[str, float] = Field(min_length=1)
    amplitude: float = 10.0
    period_s: float = Field(default=60.0, gt=0)
    from_s: float = Field(default=0.0, ge=0)
    until_s: float = Field(default=float("inf"), gt=0)
    every_s: float = Field(default=0.05, gt=0)


class WearPath:
    """Where one wear has taken its parameters at any sample.

    Args:
        wear: what moves them.
        sample_rate_hz: samples a second.
        seed: of a random walk.
    """

    def __init__(self, wear: Wear, sample_rate_hz: float, seed: Sequence[int]) -> None:
        self.wear = wear
        self.names = tuple(wear.rate)
        self._first = first_sample(wear.from_s, sample_rate_hz)
        self._end = None if math.isinf(wear.until_s) else first_sample(wear.until_s, sample_rate_hz)
        self._every = max(1, round(wear.every_s * sample_rate_hz))
        self._step_s = self._every / sample_rate_hz
        self._rng = np.random.default_rng(list(seed))
        self._walked = [np.zeros(len(self.names))]

    def offset(self, name: str, index: int) -> float:
        """Return by how much a parameter is moved at a sample."""
        if name not in self.wear.rate or index < self._first:
            return 0.0
        steps = (self._bounded(index) - self._first) // self._every
        if self.wear.kind == "walk":
            return float(self._walk(steps)[self.names.index(name)])
        angle = 2.0 * math.pi * steps * self._step_s / self.wear.period_s
        return self.wear.rate[name] * self.wear.amplitude * math.sin(angle)

    def _bounded(self, index: int) -> int:
        return index if self._end is None else min(index, max(self._end, self._first))

    def _walk(self, steps: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return where the walk is after so many steps; it is drawn in order, whoever asks."""
        spread = math.sqrt(self._step_s) * np.array(list(self.wear.rate.values()))
        while len(self._walked) <= steps:
            self._walked.append(self._walked[-1] + spread * self._rng.standard_normal(len(self.names)))
        return self._walked[steps]

    def next_after(self, index: int) -> int | None:
        """Return the next sample after `index` at which it moves."""
        if index < self._first:
            return self._first
        later = self._first + ((index - self._first) // self._every + 1) * self._every
        return None if self._end is not None and later > self._end else later
