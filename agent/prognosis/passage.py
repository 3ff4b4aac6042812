"""When a level first reaches its limit: paths simulated onward from a posterior."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from agent.prognosis.family import Scale, bent, onward
from agent.prognosis.posterior import FULL, Effort, Particles
from agent.prognosis.prior import Student
from agent.prognosis.tuning import FARTHEST, STEEPEST
from agent.types import FloatArray

FASTER = frozenset(("bend", "growth"))
"""Shapes of laws that get faster, whose rate at the limit may differ from what they say."""


@dataclass(frozen=True, slots=True)
class _Paths:
    """Paths on their way to the limit, (N,) each.

    Attributes:
        gap, rate: way in u that is left, and how fast it closes.
        walk, wander: how both scatter.
        ramp, constant, growth: how rates go on in time by themselves: r of a ramp, 0 for none; τ of a
            saturation, inf for none; g of a growth, 0 for none.
    """

    gap: FloatArray
    rate: FloatArray
    walk: FloatArray
    wander: FloatArray
    ramp: FloatArray
    constant: FloatArray
    growth: FloatArray

    @classmethod
    def joined(cls, parts: "Sequence[_Paths]") -> "_Paths":
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    def at(self, rows: NDArray[np.intp]) -> "_Paths":
        return _Paths(*(getattr(self, name)[rows] for name in self.__slots__))

    def faster(self, t: float) -> FloatArray:
        """Return the rate over the rate at the start, at t spans from now."""
        power = np.minimum(self.growth * (t + 1.0), STEEPEST) - (t + 1.0) / self.constant
        return (1.0 + self.ramp * (t + 1.0)) * np.exp(power)


def first_passages(
    found: list[Particles], scale: Scale, newest: float, later: Student, rng: np.random.Generator,
    effort: Effort = FULL,
) -> FloatArray:  # fmt: skip
    """Return (effort.paths,) times to the first passage, in spans of the history; inf where a path has none.

    Each path starts from a particle, drawn by its weight, with level and rate drawn from its Gaussian.
    newest: scaled level up to which the history shows the law; later: how much κ differs beyond.
    """
    evidence = np.array([p.log_evidence for p in found])
    share = np.exp(evidence - evidence.max())
    share /= share.sum()
    counts = np.floor(share * effort.paths + 1e-9).astype(int)
    counts[int(np.argmax(share))] += effort.paths - counts.sum()
    drawn = zip(found, counts.tolist(), strict=True)
    paths = [_paths(member, scale, newest, later, n, rng) for member, n in drawn if n]
    return _simulated(_Paths.joined(paths), effort.steps, rng)


def _paths(
    found: Particles, scale: Scale, newest: float, later: Student, n: int, rng: np.random.Generator
) -> _Paths:
    """Return n paths of one law at the newest row."""
    index = _chosen(found, n, rng)
    s = found.state
    bend = found.column("bend", 0.0)[index]
    fixed = FASTER.isdisjoint(found.names)
    beyond = bend if fixed else bend + later.draw(rng, n)
    limit = bent(np.array(newest), bend, scale)[0] + onward(newest, bend, beyond, scale)
    normal = rng.standard_normal((2, n))
    root = np.sqrt(np.maximum(s.bb[index], 0.0))
    b = s.b[index] + root * normal[0]
    lean = np.divide(s.ub[index], s.bb[index], out=np.zeros(n), where=s.bb[index] > 0)
    rest = np.maximum(s.uu[index] - lean * s.ub[index], 0.0)
    u = s.u[index] + lean * (b - s.b[index]) + np.sqrt(rest) * normal[1]
    sign = np.sign(scale.limit)
    return _Paths(
        sign * (limit - u), sign * b,
        np.exp(found.column("walk", 0.0)[index]), np.exp(found.column("wander", -np.inf)[index]),
        np.exp(found.column("ramp", -np.inf)[index]), np.exp(found.column("saturation", np.inf)[index]),
        np.exp(found.column("growth", -np.inf)[index]),
    )  # fmt: skip


def _chosen(found: Particles, n: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return n particles' places, drawn by their weights."""
    weight = np.exp(found.log_weight)
    places = (rng.uniform() + np.arange(n)) / n
    index = np.minimum(np.searchsorted(np.cumsum(weight) / weight.sum(), places), len(weight) - 1)
    return index[rng.permutation(n)]


def newest_levels(
    found: list[Particles], scale: Scale, newest: float, n: int, rng: np.random.Generator
) -> FloatArray:
    """Return n draws of the newest scaled level, as the most probable law knows it."""
    best = max(found, key=lambda one: one.log_evidence)
    index = _chosen(best, n, rng)
    at, slope = bent(np.array(newest), best.column("bend", 0.0)[index], scale)
    u = best.state.u[index] + np.sqrt(np.maximum(best.state.uu[index], 0.0)) * rng.standard_normal(n)
    levels: FloatArray = newest + (u - at) / np.exp(slope)
    return levels


def _simulated(paths: _Paths, steps: int, rng: np.random.Generator) -> FloatArray:
    """Follow paths until their gap to the limit is closed, with Brownian bridges between the steps."""
    reached = np.where(paths.gap <= 0.0, 0.0, np.inf)
    under_way = np.flatnonzero(paths.gap > 0.0)
    paths = paths.at(under_way)
    edges = np.r_[0.0, np.geomspace(1e-4, FARTHEST, steps)]
    for begin, end in pairwise(edges.tolist()):
        paths, share = _onward(paths, begin, end, rng)
        arrived = np.isfinite(share)
        reached[under_way[arrived]] = begin + share[arrived] * (end - begin)
        if arrived.any():
            rest = np.flatnonzero(~arrived)
            under_way, paths = under_way[rest], paths.at(rest)
    return reached


def _onward(paths: _Paths, begin: float, end: float, rng: np.random.Generator) -> tuple[_Paths, FloatArray]:
    """Return paths at the end of a step, and at which share of it each arrived, inf where it did not."""
    dt = end - begin
    n = len(paths.gap)
    gap, q = paths.gap, paths.walk
    step = paths.rate * paths.faster(0.5 * (begin + end)) * dt + q * np.sqrt(dt) * rng.standard_normal(n)
    rate = paths.rate * np.exp(np.minimum(paths.wander * np.sqrt(dt) * rng.standard_normal(n), 3.0))
    after = gap - step
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        touched = rng.uniform(size=n) < np.exp(-2.0 * gap * np.maximum(after, 0.0) / (q * q * dt))
        share = np.where(after <= 0.0, gap / np.maximum(step, 1e-300), np.where(touched, 0.5, np.inf))
    return replace(paths, gap=np.maximum(after, 1e-12), rate=rate), share
