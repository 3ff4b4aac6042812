"""Runs in which one spring steps by 15 %: what the pipeline raises, and when."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.runtime.replay import SOURCE, make_pipeline
from agent.types import AlarmTransition, FloatArray
from drivers.port import SampleBlock
from tests.statistical.machine import NAMES, SECOND, Machine, configuration, fresh, on_second
from tests.statistical.operation import LOADS_N, NOISE_M, drive

STEP = 0.15
WITHIN = 2 * SECOND
BLOCK = 500


@dataclass(frozen=True, slots=True)
class Play:
    """One run: readings (N, 3) force and displacements, the spring that steps at a sample, and by which
    factor."""

    readings: FloatArray
    spring: str
    at: int
    factor: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """What came of a run: samples from the step to the right alarm (None: not within 2 s) and what was blamed
    else."""

    seed: int
    spring: str
    factor: float
    delay: int | None
    blamed: tuple[str, ...]


def played(seed: int, before: tuple[int, int] = (4 * SECOND, 5 * SECOND)) -> Play:
    """Play run `seed`: the step falls anywhere in `before`, on a rig in steady motion."""
    rng = np.random.default_rng([seed, 1])
    at = int(rng.integers(*before))
    which = int(rng.integers(2))
    factor = float(1.0 + STEP * rng.choice([-1.0, 1.0]))
    machine, settle = Machine.at_rest(), 10 * SECOND
    force = rng.choice(LOADS_N) + drive(rng, settle + at + WITHIN + 1)
    pushes = on_second(force)
    first = machine.play(pushes[: settle + at + 1])[settle:]
    machine.theta[which] *= factor
    y = np.vstack([first, machine.play(pushes[settle + at :])])[:, :2]
    y = y + NOISE_M * rng.standard_normal(y.shape)
    return Play(np.column_stack([force[settle:-1], y]), NAMES[which], at, factor)


def pipeline() -> Pipeline:
    """The one configuration of detection and false alarms: window 1.0 s, limits 10 %, on-delay 0.5 s."""
    return fresh("pipeline", lambda: make_pipeline(configuration(NOISE_M)))


def records(pipe: Pipeline, readings: FloatArray, first: int = 0) -> list[Record]:
    """Give the pipeline readings that begin with sample `first`."""
    found: list[Record] = []
    for start in range(0, len(readings), BLOCK):
        piece = readings[start : start + BLOCK]
        t_ns = (np.arange(len(piece), dtype=np.int64) + first + start) * 1_000_000
        found += pipe.step(SOURCE, SampleBlock(piece, 0, None, t_ns), None, None)
    return found


def raised(found: Sequence[Record]) -> list[tuple[str, int]]:
    """(parameter, sample) of every activation."""
    alarms = [r for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"]
    return [(alarm.parameter, alarm.t_ns // 1_000_000) for alarm in alarms]


def verdict(seed: int) -> Verdict:
    """Play a run into the pipeline and judge it."""
    play = played(seed)
    return assessed(seed, play, raised(records(pipeline(), play.readings)))


def assessed(seed: int, play: Play, alarms: list[tuple[str, int]]) -> Verdict:
    """Judge what was raised in a run, (parameter, sample) of every activation."""
    right = [
        sample - play.at for parameter, sample in alarms if parameter == play.spring and sample >= play.at
    ]
    wrong = tuple(p for p, sample in alarms if p != play.spring or sample < play.at)
    return Verdict(seed, play.spring, play.factor, right[0] if right and right[0] <= WITHIN else None, wrong)
