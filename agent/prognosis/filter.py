"""Kalman filter of a level and its rate, for many hypotheses at once: every quantity is an array over them.

    u(k+1) = u(k) + h(k) b(k) + η,   b(k+1) = b(k) + ζ,   y(k) = u(k) + ε(k)

the local linear trend (Harvey 1989, Forecasting, Structural Time Series Models, section 2.3) with steps h of
any length.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agent.types import FloatArray


class State(NamedTuple):
    """A Gaussian of level u and rate b, (N,) each: means, variances, covariance."""

    u: FloatArray
    b: FloatArray
    uu: FloatArray
    ub: FloatArray
    bb: FloatArray


@dataclass(frozen=True, slots=True)
class Walk:
    """How level and rate move from one reading to the next.

    Attributes:
        h: (n - 1, N) what a rate of one adds to the level.
        level, rate, cross: (n - 1, N) variances of η and ζ, and their covariance.
    """

    h: FloatArray
    level: FloatArray
    rate: FloatArray
    cross: FloatArray

    def after(self, steps: int) -> "Walk":
        """Return the walk without its first steps."""
        return Walk(self.h[steps:], self.level[steps:], self.rate[steps:], self.cross[steps:])


def run_filter(
    y: FloatArray, variance: FloatArray, walk: Walk, start: State, total: FloatArray | float = 0.0
) -> tuple[State, FloatArray]:
    """Return the state at the newest reading and the log likelihood of all readings, (N,).

    y, variance: (n, N) readings and the variance of ε. start: the state at the first reading before it is
    read. total: the log likelihood of readings before these.
    """
    state, gained = _read(start, y[0], variance[0])
    total = total + gained
    for k in range(1, len(y)):
        state, gained = _read(moved(state, walk, k - 1), y[k], variance[k])
        total += gained
    return state, total


def moved(state: State, walk: Walk, k: int) -> State:
    """Return the state at the next reading before it is read; k: the place of the step to it."""
    h = walk.h[k]
    lean = state.ub + h * state.bb
    level = state.uu + h * (state.ub + lean) + walk.level[k]
    return State(state.u + h * state.b, state.b, level, lean + walk.cross[k], state.bb + walk.rate[k])


def _read(state: State, y: FloatArray, variance: FloatArray) -> tuple[State, FloatArray]:
    """Return the state after a reading, and the log density of that reading before it."""
    innovation = y - state.u
    spread = state.uu + variance
    level, rate = state.uu / spread, state.ub / spread
    density = -0.5 * (np.log(2.0 * np.pi * spread) + innovation * innovation / spread)
    # (1 − K) P written as K R keeps digits where a reading is far surer than what was known before it
    after = State(
        state.u + level * innovation,
        state.b + rate * innovation,
        level * variance,
        rate * variance,
        np.maximum(state.bb - rate * state.ub, 0.0),
    )
    return after, density
