"""The only reader of clocks, and the labels that samples of a live source get."""

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from agent.tuning import DEAD_ZONE_NS, SETTLE_NS, SLEW, STEP_NS
from agent.types import IntArray


def wall_ns() -> int:
    """Wall time, ns since the epoch."""
    return time.time_ns()


def monotonic_ns() -> int:
    """Monotonic time, ns."""
    return time.monotonic_ns()


def boot_id() -> str | None:
    """The kernel's identifier of this boot, where there is one."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii").strip()
    except OSError:
        return None


class Anchor(NamedTuple):
    """Where labels begin or begin anew: first sample, its label, and wall clock minus monotonic clock, ns."""

    first: int
    label_ns: int
    offset_ns: int


@dataclass(slots=True)
class SampleLabels:
    """Time stamps of live samples: anchor + index / rate, drawn slowly towards the wall clock, never back.

    The anchor is wall time at the first sample. The earliest arrivals of each 10 s say how far device and
    wall clock have drifted apart; beyond 50 ms labels run up to 0.1 % faster or slower until they agree
    again. A wall clock that was stepped by more than 1 s starts a new anchor, noted in `steps` as (label
    before, step), ns. `anchors` has the new ones and the first; who reads them empties both lists.
    """

    rate_hz: float
    steps: list[tuple[int, int]] = field(default_factory=list)
    anchors: list[Anchor] = field(default_factory=list)
    _anchor_ns: int | None = None
    _base: int = 0
    _stretch: float = 0.0
    _offset_ns: int = 0
    _watched_from: int = 0
    _least_lag: int | None = None

    def label(self, index: IntArray, arrival_ns: int, offset_ns: int) -> IntArray:
        """Return time stamps (n,) of samples arrived at a monotonic time; offset_ns is wall - monotonic."""
        wall = arrival_ns + offset_ns
        if self._anchor_ns is None:
            # the newest sample of the first block is the one that was taken just now
            self._begin(index, wall, offset_ns)
        elif abs(offset_ns - self._offset_ns) > STEP_NS:
            self.steps.append((int(self._at(index)[0]), offset_ns - self._offset_ns))
            self._begin(index, wall, offset_ns)
        self._offset_ns = offset_ns
        labels = self._at(index)
        self._watch(int(index[-1]), int(labels[-1]), wall)
        return labels

    def _begin(self, index: IntArray, wall: int, offset_ns: int) -> None:
        self._anchor_ns = wall
        self._base = int(index[-1])
        self._offset_ns = offset_ns
        self._stretch, self._watched_from, self._least_lag = 0.0, wall, None
        self.anchors.append(Anchor(int(index[0]), int(self._at(index)[0]), offset_ns))

    def _at(self, index: IntArray) -> IntArray:
        period = np.longdouble(1e9) / np.longdouble(self.rate_hz) * (1 + np.longdouble(self._stretch))
        return np.asarray((self._anchor_ns or 0) + np.rint((index - self._base) * period).astype(np.int64))

    def _watch(self, index: int, label: int, wall: int) -> None:
        """Every 10 s compare the most punctual arrival with its label and set the stretch closing the gap."""
        lag = wall - label
        self._least_lag = lag if self._least_lag is None else min(self._least_lag, lag)
        if wall - self._watched_from >= SETTLE_NS:
            error, self._least_lag, self._watched_from = self._least_lag, None, wall
            # from here on with the new stretch, continuous at this sample
            self._anchor_ns, self._base = label, index
            self._stretch = (
                0.0 if abs(error) < DEAD_ZONE_NS else float(np.clip(error / SETTLE_NS, -SLEW, SLEW))
            )
