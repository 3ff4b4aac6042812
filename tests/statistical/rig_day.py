"""Days of normal operation through the pipeline, in flat memory: what was raised, and what the days held."""

from dataclasses import dataclass

import numpy as np

from agent.runtime.replay import SOURCE
from agent.types import EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock
from tests.statistical.detection import pipeline, raised
from tests.statistical.machine import Machine
from tests.statistical.operation import Operation

DAY = 86_400_000


@dataclass(frozen=True, slots=True)
class Shift:
    """What happened in a stretch of normal operation.

    Attributes:
        samples: played.
        alarms: (parameter, sample) of every activation.
        peak: the largest displacement, m.
        shares: of the rows, by status: warming, valid, unexcited, invalid.
    """

    samples: int
    alarms: list[tuple[str, int]]
    peak: float
    shares: FloatArray


def shift(seed: int, samples: int) -> Shift:
    """Play a stretch of normal operation into the pipeline, phase by phase."""
    operation, pipe = Operation(np.random.default_rng([seed, 2]), Machine.at_rest()), pipeline()
    alarms: list[tuple[str, int]] = []
    counts, done = np.zeros(len(Status)), 0
    while done < samples:
        force, y = operation.phase()
        t_ns = (np.arange(len(force), dtype=np.int64) + done) * 1_000_000
        found = pipe.step(SOURCE, SampleBlock(np.column_stack([force, y]), done, None, t_ns), None, None)
        alarms += raised(found)
        for batch in found:
            if isinstance(batch, EstimateBatch):
                counts += np.bincount(batch.status.ravel(), minlength=len(counts))
        done += len(force)
    return Shift(done, alarms, operation.peak, counts / counts.sum())
