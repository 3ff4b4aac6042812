"""What like machines teach of a law: its parameters' mean and spread across machines (empirical Bayes).

Each history gives the parameters of the rate law with what it leaves open of them; the spread between
histories is the prior's, with Student's tails as heavy as their number allows. Numbers are a day and relative
to the level at the start, so a machine of another size or limit may use them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agent.prognosis.family import Scale, bent, onward, way_gone, way_share
from agent.prognosis.prior import Prior, Student
from agent.prognosis.traces import Trace, trace
from agent.prognosis.tuning import COUNT, FEWEST, LATER, LIGHT, SEEN, WANDER
from agent.types import FloatArray

USUAL = {"life": 0.3, "exponent": 0.5, "wander": 0.5}
"""Spread between machines of a kind before any is seen, in natural logarithms; of the exponent, in κ."""
GRID = np.linspace(-8.0, 12.0, 201)


@dataclass(frozen=True, slots=True)
class Learnt:
    """What n like machines teach.

    of: Student densities by parameter, (loc, scale, dof) each. way: what lives are counted over. later: by
    how much κ differs beyond what a history has shown, as (share of the way gone, loc, scale), the shares
    ascending. traces: each machine's course.
    """

    of: Mapping[str, tuple[float, float, float]]
    way: float
    n: int
    later: tuple[tuple[float, float, float], ...]
    traces: tuple[Trace, ...] = ()


@dataclass(frozen=True, slots=True)
class Specimen:
    """One history's law, best for all of it: ln of its life in days over a way, exponent, ln of the wander.

    later: at each of SEEN, which share of the way was gone and how much κ had to differ from then on.
    trace: its course.
    """

    life: float
    exponent: float
    wander: float
    way: float
    later: tuple[tuple[float, float], ...]
    trace: Trace

    def over(self, way: float) -> "Specimen":
        """Return the same with the life over another way."""
        lean = 1.0 - self.exponent
        ratio = way_gone(np.array(way), np.array(lean)) / way_gone(np.array(self.way), np.array(lean))
        return replace(self, life=self.life + float(np.log(np.abs(ratio))), way=way)


def specimen(t: FloatArray, z: FloatArray, scale: Scale) -> Specimen:
    """Return the law that a whole history, t (n,) days and smoothed scaled levels z (n,), follows closest.

    What share of the way in u is gone is held against what share of the time is, for each κ.
    """
    span = float(t[-1] - t[0])
    gone = (t - t[0]) / span
    bend, misfit = _closest(gone, z, scale)
    wander = float(np.log(np.clip(WANDER * misfit, 0.02, 2.0))) - 0.5 * float(np.log(span))
    later = tuple(_later(gone, z, bend, share_of_life, scale) for share_of_life in SEEN)
    return Specimen(float(np.log(span)), bend / scale.reach, wander, scale.reach, later, trace(t, z))


def _closest(t: FloatArray, z: FloatArray, scale: Scale) -> tuple[float, float]:
    """Return the κ of the law nearest levels at shares t of a time, and the rms share by which it misses."""
    u, _ = bent(z[:, None], GRID, scale)
    share = (u - u[0]) / (u[-1] - u[0])
    misfit = np.sqrt(np.mean((share - t[:, None]) ** 2, axis=0))
    best = int(np.argmin(misfit))
    return float(GRID[best]), float(misfit[best])


def _later(t: FloatArray, z: FloatArray, whole: float, seen: float, scale: Scale) -> tuple[float, float]:
    """Return the way gone after a share of life, and by how much κ differed for the rest to take its time.

    Differed from what a forecast made there would take it for: the κ of like machines, whole lives, as long
    as little of the way is gone, and of the rows up to then the more of it is.
    """
    now = float(np.interp(seen, t, z))
    way = way_share(now, scale)
    until = t <= seen
    part, _ = _closest(t[until] / seen, z[until], scale) if _has_moved(z[until]) else (whole, 0.0)
    bend = whole + way * way * (part - whole)
    gone = float(bent(np.array(now), np.array(bend), scale)[0] - bent(z[0], np.array(bend), scale)[0])
    left = onward(now, np.full(len(GRID), bend), bend + GRID, scale)
    return way, float(GRID[int(np.argmin(np.abs(left - gone * (1.0 - seen) / seen)))])


def _has_moved(z: FloatArray) -> bool:
    return len(z) >= FEWEST and bool(z[-1] != z[0])


def learn(specimens: Sequence[Specimen]) -> Learnt:
    """Return the prior that several histories of like machines lead to; at least one."""
    n = len(specimens)
    way = float(np.median([s.way for s in specimens]))
    alike = [s.over(way) for s in specimens]
    of = {}
    for name, usual in USUAL.items():
        values = np.array([getattr(s, name) for s in alike])
        beforehand = (usual / way if name == "exponent" else usual) ** 2
        spread = ((n - 1) * float(np.var(values, ddof=1)) if n > 1 else 0.0) + COUNT * beforehand
        scale = float(np.sqrt(spread / (n - 1 + COUNT) * (1.0 + 1.0 / n)))
        of[name] = (float(np.mean(values)), scale, n - 1 + COUNT + LIGHT)
    later = _later_of(np.array([s.later for s in specimens]))
    return Learnt(of, way, n, later, tuple(s.trace for s in specimens))


def _later_of(later: FloatArray) -> tuple[tuple[float, float, float], ...]:
    """Return place, mean and spread of later κ at each of SEEN, of (n, len(SEEN), 2).

    The spread is that between machines, and half the way to the neighbours' means: the next machine's stages
    fall elsewhere.
    """
    n = len(later)
    later = later[:, np.argsort(later[..., 0].mean(axis=0))]
    place, mean = later.mean(axis=0).T
    apart = 0.5 * np.abs(np.diff(mean))
    elsewhere = np.maximum(np.r_[0.0, apart], np.r_[apart, 0.0])
    between = np.var(later[..., 1], axis=0) + elsewhere**2
    spread = np.sqrt((n * between + COUNT * LATER**2) / (n - 1 + COUNT) * (1.0 + 1.0 / n))
    return tuple(zip(place.tolist(), mean.tolist(), spread.tolist(), strict=True))


def as_prior(like: Learnt, plain: Prior, scale: Scale, span: float, newest: float) -> Prior:
    """Return the prior for a history of that span and newest scaled level; other shapes as in `plain`."""
    of = dict(plain.of)
    for name, by in (("life", -np.log(span)), ("wander", 0.5 * np.log(span))):
        loc, width, dof = like.of[name]
        of[name] = Student(loc + float(by), width, dof)
    loc, width, dof = like.of["exponent"]
    of["bend"] = Student(loc * scale.reach, width * abs(scale.reach), dof)
    shares, locs, scales = zip(*like.later, strict=True)
    gone = way_share(newest, scale)
    later = Student(float(np.interp(gone, shares, locs)), float(np.interp(gone, shares, scales)), dof)
    return Prior(of, {"rate law": 0.6, "run-in": 0.25, "onset": 0.15}, later)
