"""Channels whose readings show without a model that something is wrong: they never move, or copy another."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

import numpy as np

from agent.commissioning.tuning import LEVELS, STILL
from agent.config import RigConfig
from agent.numerics.preprocessing.noise import sensor_noise
from agent.numerics.preprocessing.tuning import ROUND_OFF
from agent.runtime.assembly.acquisition_plan import channels_of
from agent.text import number
from agent.types import FloatArray


def plain_findings(config: RigConfig, v: FloatArray) -> list[dict[str, Any]]:
    """Return what is suspected of readings v (N, c), inputs first; a rig at rest is not suspected."""
    y = v[:, len(config.inputs) :]
    # at rest a coarse sensor may well read the same while a fine one shows its noise
    if not np.any(y.std(axis=0) > STILL * np.maximum(sensor_noise(y), ROUND_OFF * np.abs(y).max(axis=0))):
        return []
    return [*_still(config, v), *_same(config, v)]


def suspicion(kind: str, channels: Sequence[str], words: str, factor: float | None = None) -> dict[str, Any]:
    """Return a suspicion that is weighed against no other, as the document has it."""
    return {
        "kind": kind, "channels": list(channels), "factor": factor, "left_before": None, "left_after": None,
        "words": words,
    }  # fmt: skip


def _still(config: RigConfig, v: FloatArray) -> Iterator[dict[str, Any]]:
    """Yield outputs that never move; a force may rest all the time."""
    for channel, values in zip(config.outputs, v[:, len(config.inputs) :].T, strict=True):
        if not np.ptp(values):
            where = f"{number(float(values[0]), 4)} {channel.si_unit}"
            said = (
                f"{channel.name} never moves: it reads {where} from the first sample to the last, "
                "while others move"
            )
            yield suspicion("still", [channel.name], said)


def _same(config: RigConfig, v: FloatArray) -> Iterator[dict[str, Any]]:
    """Yield pairs that read the same to the last digit; two inputs may well be commanded alike."""
    inputs = len(config.inputs)
    channels = channels_of(config)
    for first, second in combinations(range(len(channels)), 2):
        if (
            second >= inputs
            and np.array_equal(v[:, first], v[:, second])
            and len(np.unique(v[:, first])) >= LEVELS
        ):
            names = [channels[first].name, channels[second].name]
            said = f"{names[0]} and {names[1]} read the same to the last digit: two names for one sensor?"
            yield suspicion("same", names, said)
