"""The family of degradation laws, each made linear: a level u that moves at a steady rate b with noise.

    constant     du = b dt + q dW                        u = y
    rate law     dy = b (y/y0)^m dt (…)                  u(y) = y0 ((y/y0)^(1−m) − 1)/(1 − m)
                 (Box & Cox 1964)
                 where level and limit differ in sign    u(y) = L (1 − exp(−κ (y − y0)/L))/κ
    ramp         du = b (1 + r (t − t0)) dt + q dW       u = y
    run-in       a rate that wanders freely until t_in, then the rate law
    onset        nothing until t_on, then the rate law
    saturation   du = b exp(−(t − t0)/τ) dt + q dW       u = y
    growth       du = b exp(g (t − t0)) dt + q dW        u = y

In the scale of u a rate law is a line, so one Kalman filter serves the whole family. How bent a law is has
one measure: κ = log of the rate at the limit over the rate at the start.
"""

from dataclasses import dataclass

import numpy as np

from agent.prognosis.tuning import LEAST_LEFT, STEEPEST
from agent.types import FloatArray

MEMBERS = ("constant", "rate law", "ramp", "run-in", "onset", "saturation", "growth")
SHAPES: dict[str, tuple[str, ...]] = {
    "constant": (),
    "rate law": ("bend",),
    "ramp": ("ramp",),
    "run-in": ("bend", "run_in"),
    "onset": ("bend", "onset"),
    "saturation": ("saturation",),
    "growth": ("growth",),
}
"""What each member has beyond rate, walk, scatter and, but for the steady one, wander."""
STEADY = "constant"
"""The member whose rate stays to the last: it neither bends nor wanders."""


@dataclass(frozen=True, slots=True)
class Scale:
    """What levels are measured in, so that one set of priors serves stiffness, capacity and cracks.

    Attributes:
        origin: level at the start, in the parameter's unit.
        size: what one in the scaled level is, same unit: |origin|, or the way to the limit.
        relative: whether the rate law is a power of the level; else it is an exponential of the way gone.
        limit: scaled limit.
        reach: way in the law's own coordinate, log(y/y0) or (y − y0)/L, over which κ counts; signed.
    """

    origin: float
    size: float
    relative: bool
    limit: float
    reach: float

    def scaled(self, value: FloatArray) -> FloatArray:
        return (value - self.origin) / self.size


def scale_of(smooth: FloatArray, limit: float) -> Scale:
    """Return the scale for a smoothed history (n,) and a limit."""
    origin = float(smooth[0])
    way = limit - origin
    sign = 1.0 if way >= 0.0 else -1.0
    lowest = min(float(np.min(smooth * np.sign(origin))), limit * np.sign(origin))
    if lowest > 0.02 * abs(origin):
        gone = float(np.max(np.abs(np.log(smooth / origin))))
        return Scale(
            origin, abs(origin), True, way / abs(origin), _sign_max(np.log(limit / origin), gone, sign)
        )
    size = max(abs(way), float(np.ptp(smooth)), 1e-12)
    return Scale(origin, size, False, way / size, sign)


def _sign_max(way: float, gone: float, sign: float) -> float:
    return float(np.copysign(max(abs(way), gone, 1e-6), way if way != 0.0 else sign))


def bent(z: FloatArray, bend: FloatArray, scale: Scale) -> tuple[FloatArray, FloatArray]:
    """Return u and ln(du/dz) of scaled levels z for the laws' κ; arrays that broadcast.

    With x the law's own coordinate, u = (exp(−λ x) − 1)/(−λ) and λ = κ/reach − 1 for a power of the level
    (whose dz = exp(x) dx), κ/reach else.
    """
    if scale.relative:
        sign = np.sign(scale.origin)
        x = np.log(np.maximum(1.0 + sign * z, 1e-6))
        steepness = bend / scale.reach
        u = sign * way_gone(x, 1.0 - steepness)
        return u, np.clip(-steepness * x, -STEEPEST, STEEPEST)
    steepness = bend / scale.reach
    return way_gone(z, -steepness), np.clip(-steepness * z, -STEEPEST, STEEPEST)


def onward(z: float, bend: FloatArray, later: FloatArray, scale: Scale) -> FloatArray:
    """Return the way in u from a scaled level z to the limit where the law's κ is `later` beyond z; (N,)."""
    if scale.relative:
        sign = float(np.sign(scale.origin))
        now = float(np.log(max(1.0 + sign * z, 1e-6)))
        way = float(np.log(1.0 + sign * scale.limit)) - now
        begin = np.exp(np.clip(now * (1.0 - bend / scale.reach), -STEEPEST, STEEPEST))
        return sign * begin * way_gone(np.array(way), 1.0 - later / scale.reach)
    begin = np.exp(np.clip(-z * bend / scale.reach, -STEEPEST, STEEPEST))
    return begin * way_gone(np.array(scale.limit - z), -later / scale.reach)


def way_share(z: float, scale: Scale) -> float:
    """Return the share of the way to the limit, in the law's own coordinate, that a scaled level has gone."""
    if not scale.relative:
        return z / scale.limit
    sign = float(np.sign(scale.origin))
    return float(np.log(max(1.0 + sign * z, 1e-6)) / np.log(1.0 + sign * scale.limit))


def way_left(z: float, scale: Scale) -> float:
    """Return the share of the way to the limit that is left, never less than LEAST_LEFT."""
    return max(1.0 - way_share(z, scale), LEAST_LEFT)


def life_way(bend: FloatArray, way: float, scale: Scale) -> FloatArray:
    """Return how far u is from the start over a way in the law's coordinate, for κ (N,); never negative."""
    lean = 1.0 if scale.relative else 0.0
    return np.abs(way_gone(np.array(way), lean - bend / scale.reach))


def way_gone(x: FloatArray, a: FloatArray) -> FloatArray:
    """Return (exp(a x) − 1)/a, which is x where a x is small."""
    power = np.clip(a * x, -STEEPEST, STEEPEST)
    small = np.abs(power) < 1e-8
    safe = np.where(small, 1.0, power)
    ratio = np.where(small, 1.0, np.expm1(safe) / safe)
    answer: FloatArray = x * ratio
    return answer


def instant(logit: FloatArray) -> FloatArray:
    """Return an instant of the history, from −1 to 0, for its logit."""
    answer: FloatArray = -1.0 / (1.0 + np.exp(np.minimum(logit, 700.0)))
    return answer


def progress(t: FloatArray, member: str, shape: FloatArray) -> FloatArray:
    """Return what a rate of one adds to the level from t[0] to each t; (n, N).

    t: (n,) in spans of the history, 0 the newest row and −1 the first. shape: (N, d) as SHAPES names its
    columns.
    """
    if member == "onset":
        return np.maximum(t[:, None] - instant(shape[:, 1]), 0.0)
    if member == "ramp":
        gone = t[:, None] + 1.0
        return gone + 0.5 * np.exp(shape[:, 0]) * gone * gone
    if member == "saturation":
        constant = np.exp(shape[:, 0])
        return -constant * np.expm1(-(t[:, None] + 1.0) / constant)
    if member == "growth":
        return way_gone(t[:, None] + 1.0, np.exp(shape[:, 0]))
    return np.repeat(t[:, None] + 1.0, len(shape), axis=1)
