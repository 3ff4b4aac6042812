"""Histories without what covariates do: rows as they would be with each at the centre of what was learnt."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np

from agent.blocks.covariates.compensation import dependences
from agent.records import Baseline
from agent.reference.covariates.dependence import Dependence
from agent.reference.covariates.lags import PERIOD_S, newest_period, series
from agent.reference.tuning import STRANGE
from agent.storage.read import baselines, covariates
from agent.storage.read.covariates import Means
from agent.storage.read.points import Points
from agent.storage.tuning import LAG_MEMORY_NS
from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Compensated:
    """Rows of a parameter, the covariates taken out of them, and how many rows those are unknown at."""

    points: Points
    covariates: tuple[str, ...] = ()
    unknown: int = 0


def compensated(db: Path, points: Points, standing: Sequence[Baseline] | None = None) -> Compensated:
    """Return rows with what a standing baseline says of covariates removed; unchanged where it says nothing.

    Rows at which a covariate is not known are less well known. standing: what the rig counts from; None to
    look it up. Raises StoreError.
    """
    if standing is None:
        standing = baselines.standing(db, points.rig) if len(points.t_ns) else ()
    mine = (one for one in standing if one.parameter == points.parameter and one.unit == points.unit)
    one = next(mine, None)
    found = dependences(one) if one is not None else ()
    if one is None or not found:
        return Compensated(points)
    first, last = int(points.t_ns[0]), int(points.t_ns[-1])
    return _without(points, one, found, covariates.means(db, points.rig, first - LAG_MEMORY_NS, last + 1))


def _without(
    points: Points, one: Baseline, found: Sequence[Dependence], means: Mapping[str, Means]
) -> Compensated:
    moved = np.zeros(len(points.t_ns))
    variance = np.zeros(len(points.t_ns))
    known = np.ones(len(points.t_ns))
    for dependence in found:
        lagged, share = _lagged_at(points, dependence, means.get(dependence.name))
        moved += dependence.coefficient * lagged
        variance += _variance(dependence, lagged, share)
        known = np.minimum(known, share)
    names = tuple(dependence.name for dependence in found)
    wider = replace(
        points, value=points.value - moved, sd=np.sqrt(points.sd**2 + variance),
        sd_repeat=np.sqrt(points.sd_repeat**2 + variance), reference=one.reference,
        references=(one.reference,),
    )  # fmt: skip
    return Compensated(wider, names, int((known < 0.5).sum()))


def _variance(one: Dependence, lagged: FloatArray, share: FloatArray) -> FloatArray:
    """Return how far what is taken out may be off (n,), squared, beside what is common to all rows."""
    value = one.center + lagged
    beyond = np.maximum(np.maximum(value - one.high, one.low - value), 0.0)
    missing = one.coefficient * one.spread * (1.0 - share)
    return np.asarray(missing**2 + (STRANGE * one.coefficient * beyond) ** 2)


def _lagged_at(points: Points, one: Dependence, means: Means | None) -> tuple[FloatArray, FloatArray]:
    """Return what acts of a covariate at rows (n,), over what an aggregate covers, and the share known."""
    if means is None or means.unit != one.unit:
        return np.zeros(len(points.t_ns)), np.zeros(len(points.t_ns))
    grid = series(means.number, means.value, one.center, ceil(one.hold_s / PERIOD_S))
    half = points.span_s // 2 * 10**9
    edges = [newest_period(points.t_ns + sign * half) - grid.first for sign in (-1, 1)]
    length = len(grid.deviation)
    inside = (edges[0] >= 0) & (edges[1] < length + ceil(one.hold_s / PERIOD_S))
    start, stop = (np.clip(edge, 0, length - 1) for edge in edges)

    def over(x: FloatArray) -> FloatArray:
        total = np.concatenate([[0.0], np.cumsum(x)])
        return np.asarray((total[stop + 1] - total[start]) / (stop + 1 - start))

    return over(grid.lagged(one.lag)), np.where(inside, over(grid.known(one.lag)), 0.0)
