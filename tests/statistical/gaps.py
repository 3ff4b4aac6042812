"""Runs on a constant rig whose readings have holes: do the stated intervals hold the truth?"""

from collections.abc import Callable, Mapping

import numpy as np

from agent.runtime.replay import make_pipeline
from agent.types import EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock
from tests.statistical.coverage import TRUTH, motion
from tests.statistical.machine import configuration, fresh

NOISE_M = 5e-6
WINDOWS, W = 6, 1000
LOST = 0.01
SOURCE = "recording"
Holes = Callable[[np.random.Generator, FloatArray], tuple[FloatArray, FloatArray]]


def lost_instants(rng: np.random.Generator, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One sample in a hundred never arrives: force and displacements."""
    index = np.flatnonzero((rng.random(len(v)) >= LOST) | (np.arange(len(v)) == 0))
    return v[index], index


def lost_bursts(rng: np.random.Generator, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Twice a second three samples in a row never arrive."""
    starts = (np.arange(250, len(v) - 10, 500) + rng.integers(-100, 100)).tolist()
    lost = np.concatenate([np.arange(s, s + 3) for s in starts])
    index = np.setdiff1d(np.arange(len(v)), lost)
    return v[index], index


def lost_readings(rng: np.random.Generator, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One reading in a hundred of each displacement is empty."""
    v[1:, 1:][rng.random((len(v) - 1, 2)) < LOST] = np.nan
    return v, np.arange(len(v))


def spikes(rng: np.random.Generator, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Five spikes a second in the displacements, a hundred times the noise and more."""
    for place in range(200, len(v) - 10, 200):
        v[place : place + int(rng.integers(1, 4)), int(rng.integers(1, 3))] += 0.01 * rng.choice([-1, 1])
    return v, np.arange(len(v))


HOLES: Mapping[str, Holes] = {
    "1 % lost samples": lost_instants,
    "bursts of three lost samples": lost_bursts,
    "1 % lost displacements": lost_readings,
    "spikes": spikes,
}


def one(job: tuple[str, int]) -> tuple[FloatArray, FloatArray]:
    """Return shares (4,) of disjoint windows that are valid and that are valid and cover the truth."""
    name, seed = job
    rng = np.random.default_rng([seed, 5])
    played = motion(rng, WINDOWS * W)
    v = np.column_stack([played.force, played.y + NOISE_M * rng.standard_normal(played.y.shape)])
    v, index = HOLES[name](rng, v)
    pipe = fresh("gaps", lambda: make_pipeline(configuration(NOISE_M)))
    t_ns = index.astype(np.int64) * 1_000_000
    records = pipe.step(SOURCE, SampleBlock(v, 0, None, t_ns), None, None) + pipe.finish()
    batches = [record for record in records if isinstance(record, EstimateBatch)]
    rows = np.concatenate([batch.index for batch in batches])
    which = np.isin(rows, W * np.arange(1, WINDOWS + 1) - 1)
    status, lower, upper = (
        np.concatenate([getattr(b, n) for b in batches])[which] for n in ("status", "lower", "upper")
    )
    valid = status == Status.VALID
    inside = valid & (lower <= TRUTH) & (upper >= TRUTH)
    return valid.sum(axis=0) / WINDOWS, inside.sum(axis=0) / WINDOWS
