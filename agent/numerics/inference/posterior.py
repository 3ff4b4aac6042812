"""What is carried from window to window, and what one window says."""

from dataclasses import dataclass, replace

import numpy as np

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants
from agent.numerics.inference.noise.state import Noise
from agent.numerics.inference.scatter import Scatter
from agent.types import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Footing:
    """What a point of linearisation rests on, older windows counting ever less.

    Attributes:
        information: (q, q) of the parameters, constants given.
        sensitivity: (q, c) change of the point by a change of each constant.
    """

    information: FloatArray
    sensitivity: FloatArray


@dataclass(frozen=True, slots=True)
class Place:
    """Where a window was linearised.

    Attributes:
        theta, eta: (q,), (c,) the point.
        reach: (q,) deviations within which the next window is linearised there too.
    """

    theta: FloatArray
    eta: FloatArray
    reach: FloatArray


@dataclass(frozen=True)
class Knowledge:
    """What is carried from window to window.

    Attributes:
        theta: (q,) the parameters, about which the model is linearised;  eta: (c,) likewise the constants.
        footing: what that point rests on; None of a point that is given.
        noise, constants, scatter: what has been learnt.
        kept: bins kept with all columns; 0 until a window has shown how many are needed;  kept_for: the noise
            then.
        unexplained: the newest window was not explained by the noise known before.
        place: where the newest window was linearised; None before the first.
        stretch: (s,) mean squares of extension at which springs' cubes are shares of their stiffness, m²;
            None of a rig without such springs, and before the first window.
    """

    theta: FloatArray
    eta: FloatArray
    noise: Noise
    constants: Constants
    scatter: Scatter
    kept: int = 0
    kept_for: Noise | None = None
    unexplained: bool = False
    footing: Footing | None = None
    place: Place | None = None
    stretch: FloatArray | None = None

    def stretched(self, squares: FloatArray, cubic: IntArray) -> "Knowledge":
        """Return the same where a window's mean square extensions (s,) are what springs' cubes count by.

        cubic: (s,) their constants. Only of springs that go far beyond what was so far: a cube is known there
        as it was, or not at all.
        """
        if self.stretch is None:
            return replace(self, stretch=squares)
        wider = squares > tuning.WIDER * self.stretch
        if not wider.any():
            return self
        factor = np.ones(len(self.eta))
        factor[cubic[wider]] = (squares / self.stretch)[wider]
        footing = self.footing
        if footing is not None:
            footing = replace(footing, sensitivity=footing.sensitivity / factor)
        return replace(
            self, stretch=np.where(wider, squares, self.stretch), eta=self.eta * factor, footing=footing,
            constants=self.constants.rescaled(factor), scatter=self.scatter.rescaled(factor), place=None,
        )  # fmt: skip


@dataclass(frozen=True)
class Posterior:
    """What one window says.

    Attributes:
        theta, lower, upper: (q,) mean and 95 % interval, the constants' uncertainty in it.
        sd: (q,) that of the Gaussian with as wide an interval: a hypothesis of 1 % weight does not double it.
        sd_repeat: (q,) standard deviation against another window of the same rig: the constants taken as they
            are.
        converged: Gauss-Newton came to rest.
        jump: (cuts,) twice the log likelihood ratio of a jump at each cut; jump_raw: not divided by the
            misfit.
        excess: predictive standard deviations by which the residual's power is too large;  beyond_jump: the
            same of what the best jump leaves.
        changing: a jump fits beyond what chance allows.
        slide: variance that a gain which drifts inside the window adds to the score of a jump, in units of
            the score's own;  slid: (q,) sd of what it does to the parameters, in `sd` and `sd_repeat`.
        dof: degrees of freedom of the residual.
        rubs: dry friction that the model has no term for is evident, and moves an estimate by more than its
            sd.
    """

    theta: FloatArray
    sd: FloatArray
    lower: FloatArray
    upper: FloatArray
    sd_repeat: FloatArray
    converged: bool
    jump: FloatArray
    jump_raw: FloatArray
    excess: float
    beyond_jump: float
    changing: bool
    slide: float
    slid: FloatArray
    dof: float
    rubs: bool = False

    @property
    def mismatch(self) -> bool:
        """Whether the residual's power is not explained by what the noise may be."""
        return self.excess > tuning.MISMATCH_SD

    @property
    def holds(self) -> bool:
        """Whether one set of parameters explains the window."""
        return self.converged and not self.changing and not self.mismatch

    @property
    def jumps_once(self) -> bool:
        """Whether one jump of the parameters explains a window that changes."""
        return self.changing and self.beyond_jump <= tuning.MISMATCH_SD


@dataclass(frozen=True)
class Line:
    """What one window says if each of its parameters runs a straight line through it.

    Attributes:
        end: what it says of its end; `changing`: one jump of all parameters explains it better.
        middle: (q,) where they are at its middle.
        moves: some line is more than chance.
    """

    end: Posterior
    middle: FloatArray
    moves: bool

    @property
    def holds(self) -> bool:
        """Whether lines explain the window, and better than anything that jumps once."""
        return self.end.holds and self.moves


def neglected(apart: FloatArray, unit: FloatArray, scales: FloatArray) -> FloatArray:
    """Return the term of second order (h, q) of parameters so far (h, q) from where the model is straight.

    unit: (q,) size of a deviation of 1;  scales: (h,) share by which masses and gains are elsewhere. What the
    model's curvature does there is of the size of half the square of a share, or of half its product with
    that of what moved it: an explanation that is far away is not as sure as its own data make it.
    """
    return np.asarray(0.5 * np.abs(apart) * np.maximum(np.abs(apart) / unit, scales[:, None]))


def shifted(theta: FloatArray, shift: FloatArray) -> FloatArray:
    """Parameters theta (q,) moved by shifts (h, q) due to constants: as factors, since constants scale them.

    All masses, springs, dampers and forces times c give the same motion: along that line the logarithms run
    straight.
    """
    size = np.abs(theta)
    relative = shift / np.where(size > 0, size, 1.0)
    as_factor = (size > 0) & (np.abs(relative) < 1.0)
    return np.where(
        as_factor, theta * np.exp(np.sign(theta) * np.where(as_factor, relative, 0.0)), theta + shift
    )
