"""What moves parameters besides a schedule: wear that wanders, the temperature of the day, covariates.

All add to what the schedule says, in steps of `every_s`, exact to the sample.
"""

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from sim_bus.rig.covariates.course import Covariates, Lagged
from sim_bus.rig.schedule import first_sample
from sim_bus.tables import Table


class Wear(Table):
    """One [[wear]]: how the named parameters move from `from_s` to `until_s`; then they stay where they are.

    walk: a random walk; `rate` is its standard deviation after a second, in the parameter's unit.
    temperature: a sine of `amplitude` degrees and `period_s`; `rate` is what a degree does, in the
    parameter's unit.
    covariate: what the machine feels of the covariate `channel`, `lag_s` behind it, from `center` (None: what
    it is at the first sample); `rate` is what one of its units does, in the parameter's unit.

    `percent` is the same as `rate` in per cent of the nominal value.
    """

    kind: Literal["walk", "temperature", "covariate"]
    rate: dict[str, float] = Field(default_factory=dict)
    percent: dict[str, float] = Field(default_factory=dict)
    channel: str | None = None
    lag_s: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    center: float | None = Field(default=None, allow_inf_nan=False)
    amplitude: float = 10.0
    period_s: float = Field(default=60.0, gt=0)
    from_s: float = Field(default=0.0, ge=0)
    until_s: float = Field(default=float("inf"), gt=0)
    every_s: float = Field(default=0.05, gt=0)

    @model_validator(mode="after")
    def _says_what_moves_and_by_what(self) -> Self:
        if not self.names:
            raise ValueError("names no parameter; say in rate or percent what moves")
        if (self.kind == "covariate") != (self.channel is not None):
            raise ValueError('channel names the covariate of a wear of kind "covariate", and of no other')
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that it moves."""
        return tuple(dict.fromkeys([*self.rate, *self.percent]))

    def rates(self, nominal: Mapping[str, float]) -> dict[str, float]:
        """Return what it does to each parameter, in the parameter's unit."""
        own = {name: nominal[name] * percent / 100.0 for name, percent in self.percent.items()}
        return {name: self.rate.get(name, 0.0) + own.get(name, 0.0) for name in self.names}


class WearPath:
    """Where one wear has taken its parameters at any sample.

    Args:
        wear: what moves them.
        sample_rate_hz: samples a second.
        seed: of a random walk.
        nominal: every parameter's nominal value.
        covariates: what covariates are.
    """

    def __init__(
        self,
        wear: Wear,
        sample_rate_hz: float,
        seed: Sequence[int],
        nominal: Mapping[str, float] = MappingProxyType({}),
        covariates: Covariates | None = None,
    ) -> None:
        self.wear = wear
        self.rates = wear.rates(nominal)
        self.names = tuple(self.rates)
        self._first = first_sample(wear.from_s, sample_rate_hz)
        self._end = None if math.isinf(wear.until_s) else first_sample(wear.until_s, sample_rate_hz)
        self._every = max(1, round(wear.every_s * sample_rate_hz))
        self._step_s = self._every / sample_rate_hz
        self._rng = np.random.default_rng(list(seed))
        self._walked = [np.zeros(len(self.names))]
        self._felt = None
        if covariates is not None and wear.channel is not None:
            self._felt = Lagged(covariates, wear.channel, wear.lag_s, self._step_s)

    def offset(self, name: str, index: int) -> float:
        """Return by how much a parameter is moved at a sample."""
        if name not in self.rates or index < self._first:
            return 0.0
        steps = (self._bounded(index) - self._first) // self._every
        if self._felt is not None:
            return self.rates[name] * self._departure(self._felt, steps)
        if self.wear.kind == "walk":
            return float(self._walk(steps)[self.names.index(name)])
        angle = 2.0 * math.pi * steps * self._step_s / self.wear.period_s
        return self.rates[name] * self.wear.amplitude * math.sin(angle)

    def _departure(self, felt: Lagged, steps: int) -> float:
        """Return how far what is felt is from where it moves nothing, so many steps after this begins."""
        before = self._first // self._every
        center = felt.at(0) if self.wear.center is None else self.wear.center
        return felt.at(before + steps) - center

    def _bounded(self, index: int) -> int:
        return index if self._end is None else min(index, max(self._end, self._first))

    def _walk(self, steps: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        """Return where the walk is after so many steps; it is drawn in order, whoever asks."""
        spread = math.sqrt(self._step_s) * np.array(list(self.rates.values()))
        while len(self._walked) <= steps:
            self._walked.append(self._walked[-1] + spread * self._rng.standard_normal(len(self.names)))
        return self._walked[steps]

    def next_after(self, index: int) -> int | None:
        """Return the next sample after `index` at which it moves."""
        if index < self._first:
            return self._first
        later = self._first + ((index - self._first) // self._every + 1) * self._every
        return None if self._end is not None and later > self._end else later
