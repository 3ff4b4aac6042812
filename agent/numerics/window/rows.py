"""What the bank gives: a row each hop, and for each window length the normal equations of whole windows."""

from dataclasses import dataclass

from agent.numerics.window.jump import Jumps
from agent.numerics.window.solve import Normal, Starts
from agent.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class Asked:
    """What one window says of readings that it was asked about.

    Attributes:
        index: newest sample of the window.
        sample, channel, sd: (l,) the readings and their prior.
        value: (l,) what the fill-in is wrong by at d = 0.
        slope: (l, c) how that changes with d.
        covariance: (l, l) with d given.
    """

    index: int
    sample: IntArray
    channel: IntArray
    sd: FloatArray
    value: FloatArray
    slope: FloatArray
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class Windowed:
    """Rows of one window length.

    Attributes:
        index: (N,) newest sample of each window, counted from the run's first.
        normal: normal equations.
        starts: filter states at each window's first sample.
        jumps: columns of one jump inside; None for all but the first length, and where windows have no hop
            inside.
        lost: (N,) readings of which nothing is known, for which the normal equations stand as if they had
            never been.
        unsolved: (N,) windows that lost more readings than can be eliminated: their normal equations count
            them as filled.
        asked: of the first length, what windows say of the readings that they were asked about.
    """

    index: IntArray
    normal: Normal
    starts: Starts
    jumps: Jumps | None
    lost: IntArray
    unsolved: BoolArray
    asked: tuple[Asked, ...] = ()


@dataclass(frozen=True, slots=True)
class BankRows:
    """Rows of some hops that follow one another.

    Attributes:
        index: (N,) samples at which rows fell due.
        windows: one for each length, the plan's first; None while no window of that length is whole.
    """

    index: IntArray
    windows: tuple[Windowed | None, ...]
