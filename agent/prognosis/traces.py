"""What like machines did from a level onward: how long each took to reach it, and what then remained.

    ln r = a + c (ln e − mean ln e_j) + ε,    e time to the level, r from there to the limit

a Bayesian linear regression over the machines at the level reached now (similarity-based prognostics, Wang et
al. 2008, PHM). The slope c says how much of a machine's pace persists: 1 where who wore slowly goes on so, 0
where it says nothing of what is left. No law is extrapolated, so no law's error enters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.types import FloatArray

POINTS = 32
"""Points of a trace that are evenly spread in time, and as many in level."""
SHORT = 0.05
"""Share of the way by which a trace may end before a limit and still say when it would have reached it."""
USUAL = 0.3
"""Spread between machines of a kind before any is seen, in natural logarithms of a time."""
PERSISTS = 0.5
"""How much of a pace persists before any machine is seen, and how sure that is."""
SPREADS = USUAL * np.exp(np.linspace(-3.0, 3.0, 25))
"""Spreads that are thought of; a machine or two leave open which, and many settle it."""
UNSURE = 1.0
"""Standard deviation of the spread's logarithm before any machine is seen."""
OTHER = 1.0
"""Spread of a machine of another kind about these, in the same."""
ALIKE = 0.8
"""How probable it is beforehand that a machine is of the kind of those it is compared with."""
PARTS = 4
"""Equal times whose ways are compared with those of like machines."""
TINY = 1e-30
LEAST = 1e-3
"""Share of the time so far below which a time counts as no shorter."""


class Trace(NamedTuple):
    """One machine's course: levels relative to its start, in order towards its end, and days since then."""

    level: tuple[float, ...]
    day: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Alike:
    """What traces say of a machine: how probable it is one of them, and draws of what remains, days."""

    share: float
    remains: FloatArray


def trace(t: FloatArray, z: FloatArray) -> Trace:
    """Return the trace of a monotone history: t (n,) days, z (n,) levels relative to the start."""
    sign = 1.0 if z[-1] >= z[0] else -1.0
    way = np.maximum.accumulate(sign * z)
    even_time = np.searchsorted(t, np.linspace(t[0], t[-1], POINTS))
    even_way = np.searchsorted(way, np.linspace(way[0], way[-1], POINTS))
    rows = np.unique(np.concatenate([even_time, even_way]))
    level, day = sign * way[rows], t[rows] - t[0]
    return Trace(_short(level), _short(day))


def _short(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(f"{value:.7g}") for value in values)


def alike(
    traces: Sequence[Trace],
    limit: float,
    t: FloatArray,
    smooth: FloatArray,
    now: FloatArray,
    rng: np.random.Generator,
) -> Alike | None:
    """Hold a history, t (n,) days and levels (n,), against traces; None where none of them reached the limit.

    now: (N,) draws of the newest level.
    """
    known = [found for found in (_Times.of(one, limit) for one in traces) if found is not None]
    if not known:
        return None
    spent = float(t[-1] - t[0])
    floor = LEAST * spent
    reached = np.column_stack([one.at(now) for one in known])
    left = np.maximum(np.array([one.end for one in known]) - reached, floor)
    remains = _regressed(np.log(np.maximum(reached, floor)), np.log(left), np.log(spent), rng)
    sign = np.sign(limit)
    return Alike(_probable(known, t, smooth), np.where(sign * (limit - now) <= 0.0, 0.0, np.exp(remains)))


@dataclass(frozen=True, slots=True)
class _Times:
    """When a trace first reached a level, days; rises with the way gone."""

    way: FloatArray
    day: FloatArray
    sign: float
    end: float

    @classmethod
    def of(cls, one: Trace, limit: float) -> "_Times | None":
        sign = float(np.sign(limit))
        way = sign * np.array(one.level)
        day = np.array(one.day)
        first = np.r_[True, np.diff(way) > 0.0]
        way, day = way[first], day[first]
        if len(way) < 2 or way[-1] < (1.0 - SHORT) * abs(limit):
            return None
        if way[-1] < abs(limit):
            pace = (day[-1] - day[-2]) / (way[-1] - way[-2])
            way, day = np.r_[way, abs(limit)], np.r_[day, day[-1] + pace * (abs(limit) - way[-1])]
        return cls(way, day, sign, float(np.interp(abs(limit), way, day)))

    def at(self, level: FloatArray) -> FloatArray:
        return np.minimum(np.interp(self.sign * level, self.way, self.day), self.end)


def _regressed(x: FloatArray, y: FloatArray, at: float, rng: np.random.Generator) -> FloatArray:
    """Return a draw of y at x = `at` for each row of x, y (N, n): n machines for each draw of the level."""
    n = x.shape[1]
    middle, mean = x.mean(axis=1), y.mean(axis=1)
    u, v = x - middle[:, None], y - mean[:, None]
    square, product = (u * u).sum(axis=1), (u * v).sum(axis=1)
    slope = np.full(len(x), PERSISTS)
    for _ in range(2):  # how much the slope's prior counts for follows from the spread about the line
        rest = ((v - slope[:, None] * u) ** 2).sum(axis=1)
        precision = (rest + USUAL**2) / n / PERSISTS**2
        slope = (product + precision * PERSISTS) / (square + precision)
    apart = at - middle
    chance = np.cumsum(_spreads(rest, n), axis=1)
    spread = SPREADS[(chance < rng.uniform(size=(len(x), 1))).sum(axis=1)]
    width = spread * np.sqrt(1.0 + 1.0 / n + apart**2 / (square + spread**2 / PERSISTS**2))
    draw: FloatArray = mean + slope * apart + width * rng.standard_normal(len(x))
    return draw


def _spreads(rest: FloatArray, n: int) -> FloatArray:
    """Return how probable each of SPREADS is (N, s); rest (N,): n machines' squares about their mean."""
    beforehand = -0.5 * (np.log(SPREADS / USUAL) / UNSURE) ** 2
    found = beforehand - (n - 1) * np.log(SPREADS) - 0.5 * np.divide.outer(rest, SPREADS**2)
    weight = np.exp(found - found.max(axis=1, keepdims=True))
    share: FloatArray = weight / weight.sum(axis=1, keepdims=True)
    return share


def _probable(known: Sequence[_Times], t: FloatArray, smooth: FloatArray) -> float:
    """Return how probable it is that a history is one of a kind with these, of its paces over equal times."""
    spent = float(t[-1] - t[0])
    levels = np.interp(np.linspace(t[0], t[-1], PARTS + 1), t, smooth)
    paces = np.array([np.diff(one.at(levels)) for one in known])
    apart = np.log(spent / PARTS) - np.log(np.maximum(paces, LEAST * spent))
    n = len(known)
    share = _spreads(n * np.var(apart, axis=0), n)
    square = np.mean(apart, axis=0)[:, None] ** 2
    odds = ALIKE / (1.0 - ALIKE)
    between = SPREADS**2 * (1.0 + 1.0 / n)
    of_them, other = ((share * _normal(square, more)).sum(axis=1) for more in (between, between + OTHER**2))
    odds *= float(np.prod(np.maximum(of_them, TINY) / np.maximum(other, TINY)))
    return odds / (1.0 + odds)


def _normal(square: FloatArray, variance: FloatArray) -> FloatArray:
    density: FloatArray = np.exp(-0.5 * square / variance) / np.sqrt(variance)
    return density
