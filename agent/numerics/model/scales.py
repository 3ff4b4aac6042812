"""Scales that no reading shows, whatever moves the machine.

Masses, forces and all that is estimated times c leave every motion as it is; so do motions times c of forces
divided by it, beside what unknown forces do, whose size is learnt. Either is a combination of constants and
parameters that does no more to A, B, C and D than states in another unit would: dA = 0, dB = −c B, dC = c C,
dD = 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agent.numerics.model.tuning import SAME
from agent.types import FloatArray

Matrices = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""A, B, C, D, or derivatives of them."""
SIGNS = ({"mass": 1.0, "input": 1.0}, {"output": 1.0, "input": -1.0})
"""Fixed by mechanics: what the constants of each kind do in either scale."""


@dataclass(frozen=True, slots=True)
class Scales:
    """What no reading shows.

    Attributes:
        constants: (c, k) combinations of the constants;  parameters: (q, k) what the parameters do with them.
    """

    constants: FloatArray
    parameters: FloatArray


def scales_of(
    base: Matrices, parameters: Sequence[Matrices], constants: Sequence[Matrices], kinds: Sequence[str]
) -> Scales:
    """Return the scales of a model, as it is sampled, that no reading shows.

    base: the model;  parameters, constants: its derivatives by each;  kinds: of the constants.
    """
    A, B, C, D = base
    unit = (np.zeros_like(A), B, -C, np.zeros_like(D))
    columns = np.column_stack([_flat(each) for each in (*parameters, unit)])
    by_constant = [_flat(each) for each in constants]
    found: list[FloatArray] = []
    moved: list[FloatArray] = []
    for signs in SIGNS:
        which = np.array([signs.get(kind, 0.0) for kind in kinds])
        if not which.any():
            continue
        given = which @ np.array(by_constant)
        size = np.maximum(np.abs(columns).max(axis=1), np.abs(given))
        size = np.where(size > 0, size, 1.0)
        answer = -np.linalg.lstsq(columns / size[:, None], given / size, rcond=SAME)[0]
        if np.all(np.abs(given + columns @ answer) <= SAME * size * (1.0 + np.abs(answer).sum())):
            found.append(which)
            moved.append(np.asarray(answer[:-1], dtype=np.float64))
    count = len(found)
    return Scales(
        np.array(found).reshape(count, len(kinds)).T, np.array(moved).reshape(count, len(parameters)).T
    )


def combined(each: Sequence[Matrices], direction: FloatArray) -> Matrices:
    """Return the derivatives along a direction (k,) of what `each` holds the derivatives by."""
    dA, dB, dC, dD = (np.tensordot(direction, np.stack(part), 1) for part in zip(*each, strict=True))
    return dA, dB, dC, dD


def _flat(matrices: Matrices) -> FloatArray:
    return np.concatenate([matrix.ravel() for matrix in matrices])
