"""What like machines did from a level onward: how long each took to reach it, and what then remained.

    ln r = a + c (ln e − mean ln e_j) + d (ln h − mean ln h_j) + ε

e is the time to the level, h the share of it that the second half of the way took, r the time from there to
the limit: a Bayesian linear regression over the machines at the level reached now (similarity-based
prognostics, Wang et al. 2008, PHM). The slopes say how much of a machine's pace persists: 1 where who wore
slowly goes on so, 0 where it says nothing of what is left. No law is extrapolated, so no law's error enters.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.prognosis.tuning import ALIKE, OTHER, PERSISTS, POINTS, QUARTERS, SHORT, SHORTEST, SPREAD, UNSURE
from agent.types import FloatArray

SPREADS = SPREAD * np.exp(np.linspace(-4.0, 4.0, 33))
"""Spreads that are thought of; a machine or two leave open which, and many settle it."""
TINY = 1e-30  # fixed by double precision: what may be divided by


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
    draws: int,
    rng: np.random.Generator,
) -> Alike | None:
    """Hold a history, t (n,) days and levels (n,), against traces; None where none of them reached the limit.

    now: (N,) draws of the newest level. draws: how many of what remains are made.
    """
    known = [found for found in (_Times.of(one, limit) for one in traces) if found is not None]
    if not known:
        return None
    spent = float(t[-1] - t[0])
    half = 0.5 * float(smooth[-1])
    first = float(t[int(np.argmax(np.abs(smooth) >= abs(half)))] - t[0])
    reached = np.column_stack([one.at(now) for one in known])
    before = np.array([float(one.at(np.array(half))) for one in known])
    left = np.maximum(np.array([one.end for one in known]) - reached, SHORTEST * spent)
    x = np.stack(_paces(reached, before, spent), axis=-1)
    at = np.array(_paces(np.array(spent), np.array(first), spent))
    remains = np.exp(_regressed(x, np.log(left), at, draws, rng))
    beyond = np.resize(np.sign(limit) * (limit - now) <= 0.0, draws)
    return Alike(_probable(known, t, smooth), np.where(beyond, 0.0, remains))


def _paces(reached: FloatArray, before: FloatArray, spent: float) -> tuple[FloatArray, FloatArray]:
    """Return ln of the time to a level, and ln of its share that the second half of the way took."""
    least = SHORTEST * spent
    whole = np.maximum(reached, least)
    return np.log(whole), np.log(np.clip(reached - before, least, whole) / whole)


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


def _regressed(
    x: FloatArray, y: FloatArray, at: FloatArray, draws: int, rng: np.random.Generator
) -> FloatArray:
    """Return draws (d,) of y at x = `at` (p,); x (N, n, p), y (N, n): n machines for N draws of the level."""
    n, p = x.shape[1:]
    middle = x.mean(axis=1)
    mean = y.mean(axis=1)
    u = x - middle[:, None]
    v = y - mean[:, None]
    square = np.einsum("kip,kiq->kpq", u, u)
    product = np.einsum("kip,ki->kp", u, v)
    slope = np.full((len(x), p), PERSISTS)
    for _ in range(2):  # how much the slopes' prior counts for follows from the spread about the line
        rest = ((v - np.einsum("kip,kp->ki", u, slope)) ** 2).sum(axis=1)
        precision = (rest + SPREAD**2) / n / PERSISTS**2
        ridge = square + precision[:, None, None] * np.eye(p)
        slope = np.linalg.solve(ridge, (product + precision[:, None] * PERSISTS)[..., None])[..., 0]
    free = n - 1.0 - np.trace(np.linalg.solve(ridge, square), axis1=1, axis2=2)
    apart = at - middle
    lever = np.einsum("kp,kp->k", apart, np.linalg.solve(ridge, apart[..., None])[..., 0])
    centre = mean + (slope * apart).sum(axis=1)
    chance = np.cumsum(_spreads(rest, free), axis=1)
    of = np.resize(np.arange(len(x)), draws)
    spread = SPREADS[(chance[of] < rng.uniform(size=(draws, 1))).sum(axis=1)]
    draw: FloatArray = centre[of] + spread * np.sqrt(1.0 + 1.0 / n + lever[of]) * rng.standard_normal(draws)
    return draw


def _spreads(rest: FloatArray, free: FloatArray) -> FloatArray:
    """Return how probable each of SPREADS is (N, s); rest, free (N,): sums of squares, degrees of freedom."""
    beforehand = -0.5 * (np.log(SPREADS / SPREAD) / UNSURE) ** 2
    found = beforehand - np.multiply.outer(free, np.log(SPREADS)) - 0.5 * np.divide.outer(rest, SPREADS**2)
    weight = np.exp(found - found.max(axis=1, keepdims=True))
    share: FloatArray = weight / weight.sum(axis=1, keepdims=True)
    return share


def _probable(known: Sequence[_Times], t: FloatArray, smooth: FloatArray) -> float:
    """Return how probable it is that a history is one of a kind with these, of its paces over equal times."""
    spent = float(t[-1] - t[0])
    levels = np.interp(np.linspace(t[0], t[-1], QUARTERS + 1), t, smooth)
    paces = np.array([np.diff(one.at(levels)) for one in known])
    apart = np.log(spent / QUARTERS) - np.log(np.maximum(paces, SHORTEST * spent))
    n = len(known)
    share = _spreads(n * np.var(apart, axis=0), np.full(QUARTERS, n - 1.0))
    square = np.mean(apart, axis=0)[:, None] ** 2
    odds = ALIKE / (1.0 - ALIKE)
    between = SPREADS**2 * (1.0 + 1.0 / n)
    of_them, other = ((share * _normal(square, more)).sum(axis=1) for more in (between, between + OTHER**2))
    odds *= float(np.prod(np.maximum(of_them, TINY) / np.maximum(other, TINY)))
    return odds / (1.0 + odds)


def _normal(square: FloatArray, variance: FloatArray) -> FloatArray:
    density: FloatArray = np.exp(-0.5 * square / variance) / np.sqrt(variance)
    return density
