"""What the bank gives: a row each hop, and for each window length the normal equations of whole windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
    """Rows since the last call.

    Attributes:
        index: (N,) samples at which rows fell due.
        windows: one for each length, the plan's first; None while no window of that length is whole.
    """

    index: IntArray
    windows: tuple[Windowed | None, ...]


def joined(pieces: Sequence[BankRows], lengths: int) -> BankRows:
    """Return rows one after the other."""
    if not pieces:
        return BankRows(np.zeros(0, dtype=np.int64), (None,) * lengths)
    index = np.concatenate([piece.index for piece in pieces])
    each = [[w for piece in pieces if (w := piece.windows[k]) is not None] for k in range(lengths)]
    return BankRows(index, tuple(_windowed(windows) for windows in each))


def _windowed(pieces: Sequence[Windowed]) -> Windowed | None:
    if len(pieces) < 2:
        return pieces[0] if pieces else None
    normals = [piece.normal for piece in pieces]
    starts = [piece.starts for piece in pieces]
    jumps = [piece.jumps for piece in pieces if piece.jumps is not None]
    cat = np.concatenate
    normal = Normal(
        cat([n.H for n in normals]), cat([n.g for n in normals]), cat([n.rss for n in normals]),
        normals[-1].log_det, cat([n.x0 for n in normals]),
    )  # fmt: skip
    first = Starts(
        cat([s.predicted for s in starts]), cat([s.mean for s in starts]), cat([s.tangents for s in starts])
    )
    return Windowed(
        cat([piece.index for piece in pieces]), normal, first, _jumps(jumps),
        cat([piece.lost for piece in pieces]),
        cat([piece.unsolved for piece in pieces]), tuple(one for piece in pieces for one in piece.asked),
    )  # fmt: skip


def _jumps(pieces: Sequence[Jumps]) -> Jumps | None:
    if not pieces:
        return None
    cat = np.concatenate
    index, cross, own = (cat([getattr(j, name) for j in pieces]) for name in ("index", "cross", "own"))
    return Jumps(index, cross, own, pieces[0].samples)
