"""Springs that harden or soften: a cubic force as a further input of the model, beside its linear spring.

A spring whose force is k e (1 + c e²) at the extension e pushes as one of stiffness k does, and with k c e³
besides. Where displacements show e, e³ is known as well as they are, and c is a gain of it like any other.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from agent.numerics.model.statespace import Model, StateSpace
from agent.types import FloatArray, IntArray


@dataclass(frozen=True)
class Cubic:
    """A spring whose extension outputs show.

    Attributes:
        name: of the spring.
        extension: (p,) takes its extension from the outputs.
        push: (d,) how the unknown forces act where the spring pulls its ends together with 1 N.
        stiffness: nominal, N/m.
    """

    name: str
    extension: FloatArray
    push: FloatArray
    stiffness: float


@dataclass(frozen=True)
class WithCubics:
    """A model with forces along springs as its last inputs, N.

    Attributes:
        model: the model.
        pushed: (d,) its inputs that are unknown forces.
        cubics: the springs.
    """

    model: Model
    pushed: IntArray
    cubics: tuple[Cubic, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The model's parameters."""
        return self.model.parameters

    @property
    def nominal(self) -> FloatArray:
        """(q,) their nominal values."""
        return self.model.nominal

    @property
    def state_names(self) -> tuple[str, ...]:
        """The model's states."""
        return self.model.state_names

    @cached_property
    def _along(self) -> FloatArray:
        """(d, s) what the unknown forces are where each spring pulls with 1 N."""
        return np.array([cubic.push for cubic in self.cubics]).T

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the model at theta (q,) with the springs' forces behind its inputs."""
        at = self.model.continuous(theta)
        B, D, dB, dD = (
            np.concatenate([part, part[..., self.pushed] @ self._along], axis=-1)
            for part in (at.B, at.D, at.dB, at.dD)
        )
        return replace(at, B=B, D=D, dB=dB, dD=dD)


def extensions(y: FloatArray, cubics: tuple[Cubic, ...]) -> FloatArray:
    """Return extensions (N, s) of springs, m, from outputs (N, p)."""
    return np.asarray(y @ np.array([cubic.extension for cubic in cubics]).T)


def cubed(y: FloatArray, cubics: tuple[Cubic, ...]) -> FloatArray:
    """Return k e³ (N, s) of springs, N m², from outputs (N, p)."""
    e = extensions(y, cubics)
    # a power of 3 takes thirty times as long
    return np.asarray(e * e * e * np.array([cubic.stiffness for cubic in cubics]))
