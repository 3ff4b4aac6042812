"""Inputs stacked for a polynomial hold: a sample waits until the readings that come after it are known."""

from dataclasses import dataclass

import numpy as np

from agent.numerics.model.cubic import cubed
from agent.numerics.model.sensors import with_constant
from agent.numerics.model.uncertain import Rig
from agent.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Ready:
    """Consecutive samples whose readings are all known, the first of them number `index`.

    Attributes:
        y: (N, p) outputs.
        u: (N, m + s md) the m inputs, then the md driven ones at each of the rig's s shifts.
        missing, suspect: (N, p+m) readings that were filled in and inputs that may be spikes; None where none
            was.
    """

    index: int
    y: FloatArray
    u: FloatArray
    missing: BoolArray | None
    suspect: BoolArray | None


class LookAhead:
    """Holds back a segment's newest samples until their later taps are there; none if the hold needs none."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._ahead = max((0, *rig.shifts))
        self._behind = -min((0, *rig.shifts))
        self._v: FloatArray | None = None

    def forget(self) -> None:
        """Let go of the samples of a segment that ended."""
        self._v = None

    def step(
        self, index: int, y: FloatArray, u: FloatArray, missing: BoolArray | None, suspect: BoolArray | None
    ) -> Ready:
        """Take consecutive samples y (N, p), u (N, m), from number `index` on; return those complete now."""
        cubics = self._rig.cubics
        u = with_constant(u, len(self._rig.measured) - len(cubics))
        u = np.hstack([u, cubed(y, cubics)]) if cubics else u
        if not self._rig.shifts:
            return Ready(index, y, u, missing, suspect)
        width = y.shape[1] + len(self._rig.measured)
        return self._stacked(index, y, u, [_widened(mark, len(y), width) for mark in (missing, suspect)])

    def _stacked(self, index: int, y: FloatArray, u: FloatArray, marks: list[BoolArray]) -> Ready:
        """Stack what waited and what came; the first reading of a segment stands for those before it."""
        p, m, behind, ahead = y.shape[1], u.shape[1], self._behind, self._ahead
        came = np.hstack([y, u, *marks])
        before = np.repeat(came[:1], behind, axis=0) if self._v is None else self._v
        waited = len(before) - behind
        v = np.vstack([before, came])
        count = max(len(v) - behind - ahead, 0)
        self._v = v[count:].copy()
        here = v[behind : behind + count]
        driven = v[:, p : p + m][:, self._rig.driven]
        later = [driven[behind + o : behind + o + count] for o in self._rig.shifts]
        missing, suspect = np.split(here[:, p + m :] > 0, 2, axis=1)
        stacked = np.hstack([here[:, p : p + m], *later])
        return Ready(index - waited, here[:, :p], stacked, missing, suspect)


def _widened(mark: BoolArray | None, count: int, width: int) -> BoolArray:
    """Return marks (N, width) of all readings, none without marks and for inputs that no channel reads."""
    out = np.zeros((count, width), dtype=bool)
    if mark is not None:
        out[:, : mark.shape[1]] = mark
    return out
