"""What is believed of a law's parameters before a history is seen: independent Student t densities.

Parameters by name, in the scale of the law (levels in sizes, times in spans of the history): `life` log of
the time to the limit, `walk` log q, `wander` log of the rate's relative random walk, `scatter` log of the
readings' sd beyond what is stated, and the shapes. A prior learnt of like machines holds its numbers a day
and relative to the level at the start.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from agent.types import FloatArray


@dataclass(frozen=True, slots=True)
class Student:
    """Student's t: where, how wide, how heavy its tails are."""

    loc: float
    scale: float
    dof: float = 8.0

    def draw(self, rng: np.random.Generator, n: int) -> FloatArray:
        return self.loc + self.scale * rng.standard_t(self.dof, n)

    @property
    def log_top(self) -> float:
        """The log density where it is highest."""
        half = math.lgamma(0.5 * (self.dof + 1.0)) - math.lgamma(0.5 * self.dof)
        return half - 0.5 * math.log(self.dof * math.pi) - math.log(self.scale)


@dataclass(frozen=True, slots=True)
class Prior:
    """Densities by parameter, and how probable each member of the family is."""

    of: dict[str, Student]
    members: dict[str, float] = field(default_factory=dict)
    later: Student = Student(0.0, 1e-3)
    """How much κ differs beyond what a history has shown: no law holds for ever."""

    def draw(self, rng: np.random.Generator, names: tuple[str, ...], n: int) -> FloatArray:
        """Return (n, d) draws."""
        return np.column_stack([self.of[name].draw(rng, n) for name in names])

    def log_density(self, names: tuple[str, ...], theta: FloatArray) -> FloatArray:
        """Return (n,) log densities of (n, d) parameters."""
        each = [self.of[name] for name in names]
        loc, scale, dof = np.array([(one.loc, one.scale, one.dof) for one in each]).T
        below = np.log1p(((theta - loc) / scale) ** 2 / dof) @ (0.5 * (dof + 1.0))
        return np.asarray(sum(one.log_top for one in each) - below)
