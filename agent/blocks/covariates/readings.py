"""Readings of covariates in a block of samples, and when each was taken."""

from collections.abc import Mapping

import numpy as np

from agent.types import FloatArray, IntArray
from drivers.port import SampleBlock


def instants(block: SampleBlock, rate_hz: float, before: int = 0) -> IntArray:
    """Return when a block's samples (n,) were taken, ns: as received where that is known, else as recorded.

    before: samples of the recording before it, for one without time stamps.
    """
    if block.wall_offset_ns is not None:
        return np.full(len(block), block.arrival_ns + block.wall_offset_ns, dtype=np.int64)
    if block.t_ns is not None:
        return np.asarray(block.t_ns, dtype=np.int64)
    return np.asarray(np.rint((before + np.arange(len(block))) * (1e9 / rate_hz)).astype(np.int64))


def readings(block: SampleBlock, places: Mapping[str, int]) -> dict[str, FloatArray]:
    """Return the readings (n,) of covariates, which stand in these columns."""
    return {name: block.values[:, place] for name, place in places.items()}
