"""Covariates: what a machine's surroundings do, read beside its signals, and what the machine feels of it.

The true value of a covariate is the sum of its courses; what acts on parameters follows it through a
first-order lag. Both depend on the time alone, so that a thermometer that is read once a minute and a spring
that moves each 50 ms go by the same course.
"""

import math
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from sim_bus.arrays import FloatArray
from sim_bus.columns import read_column
from sim_bus.rig.covariates.channel import CovariateChannel
from sim_bus.tables import Table
from sim_bus.tuning import COURSE_STEPS

_NEEDS = {
    "constant": (),
    "sine": ("amplitude",),
    "ramp": ("to", "over_s"),
    "recorded": ("file", "column"),
}


class Covariate(Table):
    """One [[covariate]]: what the surroundings do that `channel` reads, in its unit. Several of one add up.

    constant: `value`. sine: `value` and a sine of `amplitude` and `period_s`. ramp: from `value` `to` another
    in `over_s`, and there it stays. recorded: `column` of an NPZ or CSV `file`, a row each `every_s` and
    straight lines between them, times `gain`, again and again. `noise_sd`: of each reading; the machine feels
    none of it.
    """

    channel: str
    kind: Literal["constant", "sine", "ramp", "recorded"] = "constant"
    value: float = 0.0
    amplitude: float | None = None
    period_s: float = Field(default=86_400.0, gt=0)
    to: float | None = None
    over_s: float | None = Field(default=None, gt=0)
    file: str | None = None
    column: str | None = None
    every_s: float = Field(default=60.0, gt=0)
    gain: float = 1.0
    noise_sd: float = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Self:
        missing = [key for key in _NEEDS[self.kind] if getattr(self, key) is None]
        if missing:
            raise ValueError(f'a covariate of kind "{self.kind}" needs {", ".join(missing)}')
        return self


class Course:
    """One course as a function of time.

    Args:
        covariate: the course.
        folder: folder of the scenario file.
    """

    def __init__(self, covariate: Covariate, folder: Path) -> None:
        self.covariate = covariate
        self._rows = np.zeros(1)
        if covariate.kind == "recorded":
            self._rows = covariate.gain * read_column(folder / (covariate.file or ""), covariate.column or "")

    def at(self, t: FloatArray) -> FloatArray:
        """Return the true value at times t (n,), s."""
        one = self.covariate
        if one.kind == "sine":
            return one.value + (one.amplitude or 0.0) * np.sin(2.0 * np.pi * t / one.period_s)
        if one.kind == "ramp":
            return one.value + ((one.to or 0.0) - one.value) * np.clip(t / (one.over_s or 1.0), 0.0, 1.0)
        if one.kind == "recorded":
            place = np.arange(len(self._rows))
            return np.asarray(np.interp(t / one.every_s, place, self._rows, period=len(self._rows)))
        return np.full(len(t), one.value)


class Covariates:
    """What covariates are, and what is read of them.

    Args:
        channels: the configuration's covariates.
        courses: the scenario's; a channel without one stays in the middle of its range, at 0 without that.
        folder: folder of the scenario file.
    """

    def __init__(
        self, channels: Sequence[CovariateChannel], courses: Sequence[Covariate], folder: Path
    ) -> None:
        self.channels = tuple(channels)
        self._courses = [
            [Course(course, folder) for course in courses if course.channel == channel.name]
            for channel in channels
        ]
        self._noise_sd = [math.hypot(*(one.covariate.noise_sd for one in own)) for own in self._courses]

    def true(self, t: FloatArray) -> FloatArray:
        """Return the true values (n, covariates) at times t (n,), s, in the channels' units."""
        columns = [
            sum((course.at(t) for course in own), start=np.zeros(len(t)))
            if own
            else np.full(len(t), channel.middle)
            for channel, own in zip(self.channels, self._courses, strict=True)
        ]
        return np.column_stack(columns) if columns else np.empty((len(t), 0))

    def read(self, t: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return what is read (n, covariates) at times t (n,), s; noise is drawn where there is any."""
        values = self.true(t)
        for column, sd in enumerate(self._noise_sd):
            if sd:
                values[:, column] += sd * rng.standard_normal(len(t))
        return values


class Lagged:
    """What a machine feels of one covariate: it through a first-order lag, on a grid of equal steps.

    Before the first sample the covariate has always been what it is there. Between two steps it runs
    straight: with a = exp(-h/T) and g = (1 - a) T/h (T lag, h step),

        z(i+1) = a z(i) + (1 - g) x(i+1) - (a - g) x(i).

    Args:
        covariates: what covariates are.
        channel: the covariate.
        lag_s: T; 0 for none.
        step_s: h.
    """

    def __init__(self, covariates: Covariates, channel: str, lag_s: float, step_s: float) -> None:
        self._covariates = covariates
        self._column = [one.name for one in covariates.channels].index(channel)
        self._step_s = step_s
        self._kept = math.exp(-step_s / lag_s) if lag_s else 0.0
        self._held = (1.0 - self._kept) * lag_s / step_s
        self._last = self._true(np.zeros(1))
        self._steps = array("d", self._last.tolist())

    def _true(self, t: FloatArray) -> FloatArray:
        return self._covariates.true(t)[:, self._column]

    def at(self, step: int) -> float:
        """Return what is felt after so many steps; it is computed in order, whoever asks."""
        while len(self._steps) <= step:
            index = np.arange(len(self._steps), len(self._steps) + COURSE_STEPS, dtype=np.float64)
            ahead = self._true(self._step_s * index)
            before = np.concatenate([self._last, ahead[:-1]])
            added = (1.0 - self._held) * ahead - (self._kept - self._held) * before
            for each in added.tolist():
                self._steps.append(self._kept * self._steps[-1] + each)
            self._last = ahead[-1:]
        return float(self._steps[step])
