"""Which sample is which: what reached the estimation, held against what the sensors read.

A sample is spoilt where a reading that was used differs from what the sensor read by more than the wire's
step. The agent's own numbers may be shifted against the device's (a first sample missed, a restart): each
uninterrupted stretch is found again in what was played.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.config import RigConfig
from agent.evaluation.tuning import SEARCHED_ROWS
from agent.runtime.sources import wire_steps
from agent.types import FloatArray, IntArray, Samples


@dataclass(frozen=True, slots=True)
class Played:
    """What was played, by sample: parameters by name, readings (n, channels) SI, inputs first; the ledger."""

    parameters: Mapping[str, FloatArray]
    readings: FloatArray
    step: FloatArray
    ledger: Mapping[str, Any]

    def room(self, readings: FloatArray) -> FloatArray:
        """Return by how much a reading from the wire may differ from the sensor's: 32 bits hold 7 digits."""
        return np.asarray(0.51 * self.step + np.where(self.step > 0, 1e-9, 2e-7) * np.abs(readings))


def played(config: RigConfig, truth: Mapping[str, Any]) -> Played:
    """Return the arrays of a truth file in the order of the rig's channels."""
    names = [str(name) for name in truth["channel_names"]]
    channels = [*config.inputs, *config.outputs]
    steps = wire_steps(config)
    readings = np.column_stack([truth["readings"][:, names.index(c.name)] * c.si_factor for c in channels])
    step = np.array([steps.get(c.name, 0.0) * abs(c.scale) * c.si_factor for c in channels])
    parameters = {str(name): truth["parameters"][:, i] for i, name in enumerate(truth["parameter_names"])}
    return Played(parameters, readings, step, json.loads(str(truth["ledger"])))


@dataclass(frozen=True, slots=True)
class Matched:
    """Every sample that reached the estimation.

    Attributes:
        index: (n,) the agent's number.
        number: (n,) the device's.
        whole: (n,) nothing of it was missing or refused.
        spoilt: (n,) a reading that was used is not what the sensor read.
    """

    index: IntArray
    number: IntArray
    whole: np.ndarray[tuple[int], np.dtype[np.bool_]]
    spoilt: np.ndarray[tuple[int], np.dtype[np.bool_]]


def match(samples: Sequence[Samples], truth: Played) -> Matched:
    """Find every sample again in what was played."""
    shift, segment = 0, None
    rows: list[tuple[Any, ...]] = []
    for piece in samples:
        if not piece.usable:
            continue
        values, absent = _reading(piece)
        if piece.segment != segment or _differs(truth, piece.index + shift, values, absent).mean() > 0.5:
            segment, shift = piece.segment, _shift(truth, piece.index, values, absent, shift)
        number = piece.index + shift
        rows.append((piece.index, number, ~absent.any(axis=1), _differs(truth, number, values, absent)))
    if not rows:
        none = np.zeros(0, dtype=np.int64)
        return Matched(none, none, none.astype(np.bool_), none.astype(np.bool_))
    return Matched(*(np.concatenate(column) for column in zip(*rows, strict=True)))


def _reading(piece: Samples) -> tuple[FloatArray, np.ndarray[Any, np.dtype[np.bool_]]]:
    """Return readings (n, m + p), inputs first, and which of them were filled in."""
    values = np.hstack([piece.u, piece.y])
    inputs = piece.u.shape[1]
    if piece.missing is None:
        return values, np.zeros(values.shape, dtype=np.bool_)
    return values, np.roll(piece.missing, inputs, axis=1)


def _differs(
    truth: Played, number: IntArray, values: FloatArray, absent: np.ndarray[Any, np.dtype[np.bool_]]
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which samples hold a reading that is not the sensor's."""
    there = (number >= 0) & (number < len(truth.readings))
    expected = truth.readings[np.where(there, number, 0)]
    room = truth.room(expected)
    wrong = (np.abs(values - expected) > room) & ~absent
    return np.asarray(wrong.any(axis=1) | ~there)


def _shift(
    truth: Played,
    index: IntArray,
    values: FloatArray,
    absent: np.ndarray[Any, np.dtype[np.bool_]],
    guess: int,
) -> int:
    """Return device's number minus agent's number for a stretch; the guess where it is found nowhere."""
    whole = np.flatnonzero(~absent.any(axis=1))[:SEARCHED_ROWS]
    if not len(whole):
        return guess
    near = (np.abs(truth.readings - values[whole[0]]) <= truth.room(truth.readings)).all(axis=1)
    shifts = np.flatnonzero(near) - index[whole[0]]
    agreeing = [
        int(s) for s in shifts if not _differs(truth, index[whole] + s, values[whole], absent[whole]).any()
    ]
    return min(agreeing, key=lambda s: abs(s - guess), default=guess)
