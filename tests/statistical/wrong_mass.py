"""Runs whose configuration has a mass wrong: who is blamed, and what is said of the mass."""

from dataclasses import dataclass

import numpy as np

from agent.blocks.constants_watch import SOURCE as MODEL
from agent.records import HealthEvent
from agent.runtime.replay import make_pipeline
from agent.types import AlarmTransition, EstimateBatch, Status
from tests.statistical.detection import records
from tests.statistical.machine import MASSES, SECOND, configuration, fresh
from tests.statistical.operation import NOISE_M
from tests.statistical.sensor_faults import healthy

SAMPLES = 6 * SECOND
NOISES: tuple[tuple[float, bool], ...] = ((NOISE_M, True), (NOISE_M, False), (1e-6, True))
"""Noise of the displacements, m, and whether the configuration states it."""


@dataclass(frozen=True, slots=True)
class Job:
    """A run: the mass that is wrong (None: none), the share of it that the configuration has, which noise, a
    seed."""

    mass: str | None
    share: float
    noise: int
    seed: int


@dataclass(frozen=True, slots=True)
class Said:
    """What came of a run.

    Attributes:
        job: the run.
        advice: causes and words of all that was said of the model.
        alarms: (kind, parameter) of every activation.
        valid: share of full rows that are valid.
    """

    job: Job
    advice: tuple[tuple[str, str], ...]
    alarms: tuple[tuple[str, str], ...]
    valid: float

    @property
    def named(self) -> bool:
        """Only the wrong mass was named, by its size within a tenth."""
        if self.job.mass is None or len(self.advice) != 1:
            return False
        error = 100.0 * (1.0 / self.job.share - 1.0)
        cause, words = self.advice[0]
        said = float(words.split()[2]) * (1.0 if "larger" in words else -1.0)
        return cause == "mass" and words.startswith(f"{self.job.mass} is ") and abs(said / error - 1.0) < 0.1


def one(job: Job) -> Said:
    """Play the rig at work into a pipeline whose configuration has a mass wrong."""
    noise_m, stated = NOISES[job.noise]
    shares = {name: job.share if name == job.mass else 1.0 for name in MASSES}
    masses = (MASSES["m1"] * shares["m1"], MASSES["m2"] * shares["m2"])
    config = configuration(noise_m if stated else None, masses=masses)
    v = healthy(np.random.default_rng([job.seed, 9]), SAMPLES, noise_m)
    found = records(fresh(("wrong mass", stated, noise_m, masses), lambda: make_pipeline(config)), v)
    batches = [record for record in found if isinstance(record, EstimateBatch)]
    status = np.concatenate([b.status[:, 0] for b in batches])
    full = status != Status.WARMING
    advice = tuple((r.cause, r.message) for r in found if isinstance(r, HealthEvent) and r.source == MODEL)
    alarms = tuple(
        (r.kind, r.parameter) for r in found if isinstance(r, AlarmTransition) and r.to_state == "UNACK"
    )
    return Said(job, advice, alarms, float((status[full] == Status.VALID).mean()))
