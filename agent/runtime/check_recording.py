"""What a recording holds, channel by channel, as far as commissioning wants to know it."""

from dataclasses import dataclass
from math import comb
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.acquisition import Acquisition, Aligned
from agent.blocks.alignment import Alignment
from agent.blocks.alignment_plan import make_acquisition
from agent.blocks.friction import dry_friction
from agent.config import RigConfig
from agent.errors import RecordingError
from agent.numerics.sensors import with_constant
from agent.numerics.statespace import Discrete, simulate
from agent.runtime.replay import SOURCE, opened
from agent.types import FloatArray, IntArray
from drivers.port import Driver, DriverError

ORDER = 6
"""Of the difference that takes out the motion and leaves the noise."""


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording's samples in SI units.

    Attributes:
        name: of the file.
        u, y: (N, m) the model's inputs (with the signs of dry friction), (N, p) outputs.
        pieces: uninterrupted stretches as (first, end) rows.
        noise: (p,) standard deviation of each output's noise as its high frequencies show it; 0 where too short.
        facts: for the document.
    """

    name: str
    u: FloatArray
    y: FloatArray
    pieces: tuple[tuple[int, int], ...]
    noise: FloatArray
    facts: dict[str, Any]

    def first_state(self, discrete: Discrete, start: int, stop: int) -> FloatArray:
        """Return the state (n,) at row `start` that explains the first readings of a stretch best."""
        model, stop = discrete.model, min(stop, start + 2000)
        u = with_constant(self.u[start:stop], model.m)
        shift = discrete.B1 @ u[0]
        _, forced = simulate(discrete, shift, u)
        free = np.empty((len(u), model.p, model.n))
        row = model.C
        for k in range(len(u)):
            free[k], row = row, row @ model.A
        found = np.linalg.lstsq(free.reshape(-1, model.n), (self.y[start:stop] - forced).ravel(), rcond=1e-12)[0]
        return np.asarray(found + shift)


def read_recording(config: RigConfig, path: Path) -> Recorded:
    """Read a recording as `replay` would. Raises RecordingError where nothing in it can be used."""
    driver = opened(config, path)
    try:
        acquisition = _acquisition(config)
        aligned = _all(acquisition, driver)
    finally:
        driver.close()
    if not aligned:
        raise RecordingError.at(str(path), "holds no sample with every channel", "see that channels and columns fit")
    u, y = np.vstack([a.u for a in aligned]), np.vstack([a.y for a in aligned])
    friction = dry_friction(config, np.zeros(y.shape[1]))
    inputs = np.vstack([friction.step(a) for a in aligned])
    index = np.concatenate([a.index for a in aligned])
    noise = np.array([_noise(y[:, r]) for r in range(y.shape[1])])
    facts = _facts(config, acquisition, driver, (u, y, index), noise)
    return Recorded(path.name, inputs, y, _pieces(aligned), noise, facts)


def _acquisition(config: RigConfig) -> Acquisition | Alignment:
    names = {channel.name: channel.name for channel in (*config.inputs, *config.outputs)}
    return make_acquisition(config, {SOURCE: names}, np.zeros(len(config.outputs)), keep_incomplete=False)


def _all(acquisition: Acquisition | Alignment, driver: Driver) -> list[Aligned]:
    found: list[Aligned] = []
    while True:
        try:
            found += acquisition.step(SOURCE, driver.read(1.0), driver.counter_modulus)
        except EOFError:
            return found + (acquisition.finish() if isinstance(acquisition, Alignment) else [])
        except DriverError as error:
            raise RecordingError.at("", str(error), "mend or cut the recording") from error


def _pieces(aligned: list[Aligned]) -> tuple[tuple[int, int], ...]:
    """Join blocks of one segment."""
    pieces: list[tuple[int, int]] = []
    row, segment = 0, None
    for block in aligned:
        end = row + len(block.index)
        if block.segment == segment:
            pieces[-1] = (pieces[-1][0], end)
        else:
            pieces.append((row, end))
        row, segment = end, block.segment
    return tuple(pieces)


def _noise(signal: FloatArray) -> float:
    """Estimate white noise from the sixth difference, by its median so that jumps do not count."""
    if len(signal) < 10 * ORDER:
        return 0.0
    left = np.diff(signal, ORDER)
    spread = 1.4826 * float(np.median(np.abs(left)))
    return float((spread or float(np.std(left))) / comb(2 * ORDER, ORDER) ** 0.5)


def _facts(
    config: RigConfig, acquisition: Acquisition | Alignment, driver: Driver,
    columns: tuple[FloatArray, FloatArray, IntArray], noise: FloatArray,
) -> dict[str, Any]:  # fmt: skip
    u, y, index = columns
    state = acquisition.sources[SOURCE]
    span = int(index[-1] - index[0]) / config.rig.sample_rate_hz
    noises = [None] * u.shape[1] + noise.tolist()
    channels = [
        {
            "name": channel.name, "unit": channel.si_unit, "rate_hz": (len(index) - 1) / span if span else None,
            "min": float(values.min()), "max": float(values.max()), "rms": float(np.sqrt(np.mean(values**2))),
            "noise_sd": sd,
        }
        for channel, values, sd in zip([*config.inputs, *config.outputs], [*u.T, *y.T], noises, strict=True)
    ]  # fmt: skip
    rejected = driver.counts.rejected + state.refusals()
    return {"span_s": span, "received": driver.counts.received, "used": len(index), "gaps": state.gaps,
            "missing": state.missing, "rejected": dict(rejected), "channels": channels}  # fmt: skip
