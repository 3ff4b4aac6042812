"""Forces on the nodes: one column a node, one row a sample, in order and without end.

Random forces are independent normal numbers at the samples; with hold "first" the force runs linearly between
them.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from sim_bus.arrays import FloatArray, IntArray
from sim_bus.columns import read_column
from sim_bus.tables import Table

_NEEDS = {
    "random": ("rms",),
    "sweep": ("amplitude", "from_hz", "to_hz", "over_s"),
    "steps": ("amplitude", "period_s"),
    "impacts": ("amplitude", "period_s", "width_s"),
    "recorded": ("file", "column"),
    "none": (),
}


class Force(Table):
    """One [[force]] of a scenario. Without `at` it acts wherever the configuration has a force channel.

    random: normal, `rms`, N. sweep: `amplitude`, `from_hz` to `to_hz` in `over_s`, again and again. steps:
    plus and minus `amplitude`, changing each half `period_s`. impacts: a half sine of `amplitude` and
    `width_s` each `period_s`, every blow another by `spread` (a share of the amplitude, one standard
    deviation). recorded: `column` of an NPZ or CSV `file`, times `gain`, again and again. Outside `from_s` ..
    `until_s` it is 0.
    """

    kind: Literal["random", "sweep", "steps", "impacts", "recorded", "none"]
    at: str | None = None
    rms: float | None = Field(default=None, ge=0)
    amplitude: float | None = None
    from_hz: float | None = Field(default=None, ge=0)
    to_hz: float | None = Field(default=None, ge=0)
    over_s: float | None = Field(default=None, gt=0)
    period_s: float | None = Field(default=None, gt=0)
    width_s: float | None = Field(default=None, gt=0)
    spread: float = Field(default=0.0, ge=0)
    file: str | None = None
    column: str | None = None
    gain: float = 1.0
    from_s: float = 0.0
    until_s: float = float("inf")

    @model_validator(mode="after")
    def _has_what_its_kind_needs(self) -> Self:
        missing = [key for key in _NEEDS[self.kind] if getattr(self, key) is None]
        if missing:
            raise ValueError(f'a force of kind "{self.kind}" needs {", ".join(missing)}')
        return self


def _sweep(force: Force, t: FloatArray) -> FloatArray:
    low, high, over = force.from_hz or 0.0, force.to_hz or 0.0, force.over_s or 1.0
    into = np.mod(t, over)
    return (force.amplitude or 0.0) * np.sin(
        2.0 * np.pi * (low * into + (high - low) * into**2 / (2.0 * over))
    )


def _steps(force: Force, t: FloatArray) -> FloatArray:
    half = np.floor(t / ((force.period_s or 1.0) / 2.0) + 1e-9).astype(np.int64) % 2
    return np.asarray((force.amplitude or 0.0) * (1.0 - 2.0 * half), dtype=np.float64)


class _Blows:
    """Blows of a hammer, none like the other."""

    def __init__(self, force: Force, rate: float, rng: np.random.Generator) -> None:
        self._force = force
        self._rate = rate
        self._rng = rng
        self._strengths = np.ones(0)

    def __call__(self, index: IntArray) -> FloatArray:
        force = self._force
        t = index / self._rate
        period = force.period_s or 1.0
        blow = np.floor(t / period + 1e-9).astype(np.int64)
        while len(self._strengths) <= int(blow.max(initial=0)):
            self._strengths = np.append(self._strengths, 1.0 + force.spread * self._rng.standard_normal(64))
        into = (t - blow * period) / (force.width_s or 1.0)
        shape = np.where((into >= 0) & (into < 1.0), np.sin(np.pi * np.clip(into, 0.0, 1.0)), 0.0)
        return np.asarray((force.amplitude or 0.0) * self._strengths[blow] * shape)


_SHAPES: dict[str, Callable[[Force, FloatArray], FloatArray]] = {
    "sweep": _sweep,
    "steps": _steps,
    "none": lambda _force, t: np.zeros_like(t),
}


class ForceStream:
    """The forces of all nodes, drawn in order.

    Args:
        forces: the scenario's forces, each with its node.
        nodes: names of the nodes.
        sample_rate_hz: samples a second.
        seed: of the random forces.
        folder: folder of the scenario file.
    """

    def __init__(
        self,
        forces: Sequence[tuple[Force, str]],
        nodes: Sequence[str],
        sample_rate_hz: float,
        seed: int,
        folder: Path,
    ) -> None:
        self._nodes = len(nodes)
        self._rate = sample_rate_hz
        self._next = 0
        self._parts = [
            (
                list(nodes).index(at),
                self._generator(force, np.random.default_rng([seed, 1, number]), folder),
                force,
            )
            for number, (force, at) in enumerate(forces)
        ]

    def _generator(
        self, force: Force, rng: np.random.Generator, folder: Path
    ) -> Callable[[IntArray], FloatArray]:
        if force.kind == "random":
            rms = force.rms or 0.0
            return lambda index: rms * rng.standard_normal(len(index))
        if force.kind == "impacts":
            return _Blows(force, self._rate, rng)
        if force.kind == "recorded":
            file = folder / (force.file or "")
            column = read_column(file, force.column or "")
            return lambda index: force.gain * column[index % len(column)]
        shape = _SHAPES[force.kind]
        return lambda index: shape(force, index / self._rate)

    def take(self, count: int) -> FloatArray:
        """Return the next `count` samples (count, nodes)."""
        index = np.arange(self._next, self._next + count)
        self._next += count
        out = np.zeros((count, self._nodes))
        t = index / self._rate
        for node, generate, force in self._parts:
            out[:, node] += np.where((t >= force.from_s) & (t < force.until_s), generate(index), 0.0)
        return out
