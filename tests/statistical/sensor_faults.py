"""Runs in which a sensor goes wrong on a sound rig: what the pipeline blames."""

from dataclasses import dataclass

import numpy as np

from agent.types import AlarmTransition, FloatArray
from tests.statistical.detection import pipeline, records
from tests.statistical.machine import SECOND, Machine, on_second
from tests.statistical.operation import FULL_SCALE_M, LOADS_N, NOISE_M, drive

FAULTS = ("gain", "bias", "stuck", "force gain")
AFTER = 4 * SECOND
CHANNELS = ("force", "x1", "x2")


@dataclass(frozen=True, slots=True)
class Blame:
    """What came of a run: the channel at fault, the sensors blamed, the parameters alarmed, samples to the
    first."""

    seed: int
    kind: str
    channel: str
    sensors: tuple[str, ...]
    parameters: tuple[str, ...]
    delay: int | None

    @property
    def right(self) -> bool:
        """The right sensor and no other, or none at all (the estimates then say that they cannot tell)."""
        return set(self.sensors) <= {self.channel} and not self.parameters


def healthy(rng: np.random.Generator, samples: int, noise_m: float = NOISE_M) -> FloatArray:
    """Force and displacements of the rig at work, (samples, 3)."""
    settle = 10 * SECOND
    force = rng.choice(LOADS_N) + drive(rng, settle + samples + 1)
    y = Machine.at_rest().play(on_second(force))[settle:, :2]
    return np.column_stack([force[settle:-1], y + noise_m * rng.standard_normal(y.shape)])


def one(job: tuple[str, int]) -> Blame:
    """Play one fault: gain by 5 % or an offset of 1 % of full scale, either way, or a stuck displacement."""
    kind, seed = job
    rng = np.random.default_rng([seed, 7])
    at = int(rng.integers(4 * SECOND, 5 * SECOND))
    v = healthy(rng, at + AFTER)
    channel = 0 if kind == "force gain" else int(rng.integers(1, 3))
    sign = rng.choice([-1.0, 1.0])
    if kind == "stuck":
        v[at:, channel] = v[at, channel]
    elif kind == "bias":
        v[at:, channel] += sign * 0.01 * FULL_SCALE_M
    else:
        v[at:, channel] *= 1.0 + 0.05 * sign
    found = records(pipeline(), v)
    raised = [r for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    sensors = [(r.parameter, r.t_ns // 1_000_000 - at) for r in raised if r.kind == "sensor"]
    levels = tuple(r.parameter for r in raised if r.kind == "level")
    names, delay = tuple(name for name, _ in sensors), sensors[0][1] if sensors else None
    return Blame(seed, kind, CHANNELS[channel], names, levels, delay)
