"""Predicted against measured motion: the model runs free through windows; what it leaves is unexplained."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.readings import Recorded
from agent.config import RigConfig
from agent.numerics.model.holds import straight
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.statespace import Discrete, discretise, simulate
from agent.types import FloatArray


@dataclass(frozen=True)
class Explained:
    """What a model explains of recorded motion.

    Attributes:
        measured, predicted: (N, p) outputs of all windows, SI, the windows' means taken out of neither.
        share: (p,) mean square of what is left, in that of the motion about its mean; 1 at most.
        beyond: (p,) the same with the sensors' noise taken off.
    """

    measured: FloatArray
    predicted: FloatArray
    share: FloatArray
    beyond: FloatArray


def explained(
    config: RigConfig, theta: FloatArray, records: Sequence[Recorded], window: int, noise: FloatArray
) -> Explained:
    """Run the model at theta (q,) through every window, from the state its readings show; noise (p,), SI."""
    hold = straight(config.estimator.hold)
    discrete = discretise(rig_model(config).model.continuous(theta), 1.0 / config.rig.sample_rate_hz, hold)
    measured, predicted = [], []
    for record in records:
        for first, end in windows_of(record, window):
            u = with_constant(record.u[first:end], discrete.model.m)
            measured.append(record.y[first:end])
            predicted.append(free_run(discrete, record.y[first:end], u))
    whole = np.concatenate(measured)
    left = np.concatenate(measured) - np.concatenate(predicted)
    motion = np.maximum(np.mean((whole - whole.mean(axis=0)) ** 2, axis=0), 1e-300)
    rest = np.mean(left**2, axis=0)
    # what predicts worse than nothing explains nothing
    share = np.minimum(rest / motion, 1.0)
    beyond = np.clip((rest - noise**2) / motion, 0.0, 1.0)
    return Explained(whole, np.concatenate(predicted), share, beyond)


def free_run(discrete: Discrete, y: FloatArray, u: FloatArray) -> FloatArray:
    """Return outputs (W, p) under inputs u (W, m) from the state that fits the measurement best."""
    n = discrete.model.n
    _, forced = simulate(discrete, np.zeros(n), u)
    free = np.array([simulate(discrete, unit, np.zeros_like(u))[1].ravel() for unit in np.eye(n)]).T
    size = np.maximum(np.abs(free).max(axis=0), 1e-300)
    first = np.linalg.lstsq(free / size, (y - forced).ravel(), rcond=1e-12)[0]
    return np.asarray(forced + (free / size @ first).reshape(y.shape))


def windows_of(record: Recorded, window: int) -> list[tuple[int, int]]:
    """Return the disjoint windows (first, end) of a record's uninterrupted pieces."""
    return [(a, a + window) for first, end in record.pieces for a in range(first, end - window + 1, window)]
