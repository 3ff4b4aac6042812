"""How fast a device's clock runs against the gateway's, from when its samples arrive.

A sample never arrives before it was taken, so arrival times lie above the straight line of the two clocks by
a delay that is never negative: the line is the lower envelope of the arrivals. Of all lines below every
arrival the one that leaves least above it is an edge of the lower convex hull, the one over the mean time
(Moon, Skelly, Towsley, IEEE INFOCOM 1999, 227, who solve it as a linear programme).
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from agent.numerics.preprocessing.tuning import BIN_S, BINS, CAUTION, LEAST_BINS, LONGEST_S, SPREAD_S
from agent.types import FloatArray


class Line(NamedTuple):
    """The two clocks of a device and its gateway.

    Gateway time since the first arrival = offset_s + (1 + slope) · device time since that sample.
    """

    offset_s: float
    slope: float


class Drift(NamedTuple):
    """The device's clock gains so many millionths on the gateway's, over so many seconds; sd in the same."""

    ppm: float
    sd: float
    span_s: float


@dataclass(slots=True)
class ClockFit:
    """Collects arrivals of one device; deterministic in its arrivals, bounded in memory.

    Attributes:
        rate_hz: the nominal rate at which the device counts.
    """

    rate_hz: float
    _origin: tuple[int, int] | None = None
    _bin_s: float = BIN_S
    _bins: dict[int, tuple[float, float]] = field(default_factory=dict)

    def observe(self, index: int, arrival_ns: int) -> None:
        """Take the number of the newest sample of a block and the monotonic time at which it arrived."""
        if self._origin is None:
            self._origin = (index, arrival_ns)
        device, late = self._place(index, arrival_ns)
        number = int(device // self._bin_s)
        if number not in self._bins or late < self._bins[number][1]:
            self._bins[number] = (device, late)
        if len(self._bins) > BINS:
            self._forget()

    def _place(self, index: int, arrival_ns: int) -> tuple[float, float]:
        """Device time since the first sample, and how much later than it the arrival was, s."""
        first, began = self._origin or (index, arrival_ns)
        device = (index - first) / self.rate_hz
        return device, (arrival_ns - began) / 1e9 - device

    def _forget(self) -> None:
        if self._bin_s >= LONGEST_S:
            del self._bins[min(self._bins)]
            return
        self._bin_s *= 2
        joined: dict[int, tuple[float, float]] = {}
        for number, point in self._bins.items():
            half = number // 2
            if half not in joined or point[1] < joined[half][1]:
                joined[half] = point
        self._bins = joined

    @property
    def span_s(self) -> float:
        """Device time from the first arrival kept to the newest."""
        return (
            max(p[0] for p in self._bins.values()) - min(p[0] for p in self._bins.values())
            if self._bins
            else 0.0
        )

    def line(self, trusted_s: float = 0.0) -> Line:
        """Return both clocks; with arrivals over less than trusted_s the device is taken to keep its rate."""
        points = np.array(sorted(self._bins.values())).reshape(-1, 2)
        if len(points) < 2 or self.span_s < trusted_s:
            return Line(float(points[:, 1].min(initial=np.inf if len(points) else 0.0)), 0.0)
        return lower_line(points)

    def at_s(self, line: Line, index: float) -> float:
        """Return the gateway's time of a sample, s, as early as arrivals show it."""
        first, began = self._origin or (0, 0)
        return began / 1e9 + line.offset_s + (1 + line.slope) * (index - first) / self.rate_hz

    def drift(self) -> Drift | None:
        """Return how fast the device's clock runs; None before there is enough to tell how sure that is."""
        # the stretch that is not over may hold no punctual arrival yet
        points = np.array(sorted(self._bins.values())[:-1]).reshape(-1, 2)
        if len(points) < LEAST_BINS:
            return None
        line = lower_line(points)
        above = points[:, 1] - line.offset_s - line.slope * points[:, 0]
        spread = np.std(points[:, 0]) * len(points) ** 0.5
        scatter = max(1.4826 * float(np.median(np.abs(above - np.median(above)))), SPREAD_S)
        gain = 1 / (1 + line.slope) - 1
        return Drift(1e6 * gain, 1e6 * CAUTION * scatter / float(spread), self.span_s)


def lower_line(points: FloatArray) -> Line:
    """Return the line below points (n >= 2, 2), ordered by first coordinate, that leaves least above it."""
    hull = _lower_hull(points)
    if len(hull) == 1:
        return Line(float(hull[0, 1]), 0.0)
    middle = float(np.mean(points[:, 0]))
    edge = int(np.clip(np.searchsorted(hull[:, 0], middle) - 1, 0, len(hull) - 2))
    (x0, y0), (x1, y1) = hull[edge], hull[edge + 1]
    slope = (y1 - y0) / (x1 - x0)
    return Line(float(y0 - slope * x0), float(slope))


def _lower_hull(points: FloatArray) -> FloatArray:
    """Andrew's monotone chain."""
    hull: list[tuple[float, float]] = []
    for x, y in points.tolist():
        if hull and x <= hull[-1][0]:
            if y >= hull[-1][1]:
                continue
            hull.pop()
        while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], (x, y)):
            hull.pop()
        hull.append((x, y))
    return np.array(hull)


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) <= 0
