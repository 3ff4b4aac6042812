"""How many times too large a channel reads if the nominal model is right, roughly: a search's first guess."""

import numpy as np

from agent.commissioning.tuning import LEAST_SCALE, MOST_SCALE
from agent.numerics.model.statespace import Discrete, simulate
from agent.types import FloatArray


def factor_of_output(sampled: Discrete, y: FloatArray, u: FloatArray, output: int) -> float | None:
    """Return the factor of one output of y (N, p) under all of the model's inputs u (N, m); None if unclear.

    The initial state and 1 / factor are fitted by linear least squares, the parameters as they are.
    """
    target = y - _forced(sampled, u)
    column = np.zeros_like(y)
    target[:, output], column[:, output] = -(y - target)[:, output], -y[:, output]
    return _factor(sampled, y, target, column)


def factor_of_input(sampled: Discrete, y: FloatArray, u: FloatArray, without: FloatArray) -> float | None:
    """Return the factor of an input zero in `without` (N, m) and not in u; else as `factor_of_output`."""
    rest = _forced(sampled, without)
    return _factor(sampled, y, y - rest, _forced(sampled, u) - rest)


def _factor(sampled: Discrete, y: FloatArray, target: FloatArray, column: FloatArray) -> float | None:
    weight = 1.0 / np.maximum(np.sqrt(np.mean(y**2, axis=0)), 1e-300)
    design = np.concatenate([_free(sampled, len(y)), column[:, :, None]], axis=2) * weight[:, None]
    found = np.linalg.lstsq(design.reshape(-1, design.shape[2]), (target * weight).ravel(), rcond=1e-10)[0]
    gain = abs(float(found[-1]))
    return 1.0 / gain if LEAST_SCALE < gain < MOST_SCALE else None


def _forced(sampled: Discrete, u: FloatArray) -> FloatArray:
    """Return the outputs (N, p) of a model that inputs move from rest."""
    return simulate(sampled, np.asarray(sampled.B1 @ u[0]), u)[1]


def _free(sampled: Discrete, count: int) -> FloatArray:
    """Return how outputs (N, p) follow from each of the initial states, (N, p, n)."""
    free = np.empty((count, sampled.model.p, sampled.model.n))
    row = sampled.model.C
    for k in range(count):
        free[k], row = row, row @ sampled.model.A
    return free
