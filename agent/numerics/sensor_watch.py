"""Channels that stopped telling: stuck at one value while others move, or clipped at the end of their range.

Judged block by block (counted from the stretch's first sample, so that results do not depend on how the stream was
cut), by what a channel usually does: a coarse channel that often stays on one step may do so longer than a fine one.
Where nothing moves nothing is stuck: standstill is no fault.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from agent.numerics.bridge import runs

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Kind = Literal["stuck", "saturated"]
SMOOTH = 20.0
"""A range this many times the noise is motion whatever the channel did before."""
LIVELY = 0.3
"""A range of this share of the channel's usual one is motion too."""
MOVES = 8.0
"""Nothing below this many steps of the wire is motion."""
SHORTEST = 24
"""Samples that a channel must stand still, while others move, at least."""
PATIENT = 3
"""It must stand still this many times longer than it has in health."""
FADE = 0.995
"""What is left a block later of a channel's usual range."""
PLATEAU = 4
"""Equal readings at the extreme that may be a clipped peak ..."""
OVERSHOOT = 16.0
"""... if the motion before would have gone this many steps (or noise) beyond it: a rounded peak goes about four."""
ENTRY = 16
"""Samples before a standstill over which the speed is taken with which it was entered ..."""
ABRUPT = 32.0
"""... and the steps it must have missed since then to be no turning point, which misses eight to eighteen."""


@dataclass(frozen=True, slots=True)
class Finding:
    """From sample `stop` of the stretch on a channel is known to be at fault, or (kind None) sound again."""

    stop: int
    channel: int
    kind: Kind | None


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Facts of N blocks: lowest, highest (N, c), noise (N, c), equal (N, c) whether PLATEAU readings in a row are."""

    low: FloatArray
    high: FloatArray
    noise: FloatArray
    equal: BoolArray


class SensorWatch:
    """Watches the channels of a rig.

    Args:
        inputs: (c,) which channels are inputs; those may stand still while the rig moves.
        step: (c,) the wire's smallest step of each channel, SI; 0 where it has none.
        window: samples of the estimator's window.
    """

    def __init__(self, inputs: BoolArray, step: FloatArray, window: int) -> None:
        c = len(step)
        self.block = int(np.clip(window // 16, 8, 64))
        self._inputs, self._step, self._window = inputs, step, window
        self._usual = np.zeros(c)
        self._longest = np.zeros(c)
        self._low, self._high = np.full(c, np.inf), np.full(c, -np.inf)
        self._run_low, self._run_high = np.full(c, np.inf), np.full(c, -np.inf)
        self._still = np.zeros(c)
        self._speed = np.zeros(c)  # with which the present standstill was entered, a sample
        self._kinds: list[Kind | None] = [None] * c
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch; a channel that was at fault is so until it moves again."""
        # samples of context, then the block that is not whole yet
        self._pending: FloatArray = np.zeros((0, len(self._step)))
        self._context = 0
        self._done = 0

    def take(self, v: FloatArray) -> list[Finding]:
        """Take further samples v (N, c); return what changed, in order."""
        self._pending = np.concatenate([self._pending, v])
        whole = (len(self._pending) - self._context) // self.block
        if not whole:
            return []
        blocks = self._facts(whole)
        found: list[Finding] = []
        doubtful = self._doubtful(blocks)
        b = 0
        while b < whole:
            quiet = self._quiet_until(doubtful, b)
            if quiet > b:
                self._skip(blocks, slice(b, quiet))
            else:
                quiet = b + 1
                self._done += self.block
                found += self._judge(blocks, b)
            b = quiet
        start = self._context + whole * self.block
        self._context = min(start, ENTRY)
        self._pending = self._pending[start - self._context :]
        return found

    def _doubtful(self, blocks: _Blocks) -> BoolArray:
        """(N,) blocks in which some channel stands still, or stays at an extreme."""
        before = np.maximum.accumulate(np.vstack([self._high, blocks.high]))[:-1]
        below = np.minimum.accumulate(np.vstack([self._low, blocks.low]))[:-1]
        reach = 0.5 * self._step
        extreme = blocks.equal & ((blocks.high >= before - reach) | (blocks.low <= below + reach))
        still = (blocks.high - blocks.low <= 1.01 * self._step) & ~self._inputs
        return np.asarray((still | extreme).any(axis=1))

    def _quiet_until(self, doubtful: BoolArray, b: int) -> int:
        """Return the next block that must be looked at."""
        if self._still.any() or any(self._kinds):
            return b
        ahead = doubtful[b:]
        return b + int(np.argmax(ahead)) if ahead.any() else len(doubtful)

    def _skip(self, blocks: _Blocks, which: slice) -> None:
        """Take blocks in which everything moves."""
        low, high = blocks.low[which], blocks.high[which]
        self._done += self.block * len(low)
        self._low, self._high = np.minimum(self._low, low.min(axis=0)), np.maximum(self._high, high.max(axis=0))
        size = high - low
        faded = FADE ** np.arange(len(low) - 1, -1, -1)[:, None]
        moved = np.where(size > MOVES * self._step, size, 0.0)
        self._usual = np.maximum(self._usual * FADE ** len(low), (moved * faded).max(axis=0))
        self._run_low, self._run_high = low[-1], high[-1]

    def _facts(self, whole: int) -> _Blocks:
        start, c = self._context, len(self._step)
        stop = start + whole * self.block
        x = self._pending[:stop]
        cut = x[start:].reshape(whole, self.block, c)
        third = np.abs(np.diff(cut, n=3, axis=1))
        # of white noise the third difference has sd sqrt(20), and its mean size is 0.8 sd
        noise = third.mean(axis=1) / (0.8 * np.sqrt(20.0))
        same = np.diff(x, axis=0, prepend=np.nan) == 0
        equal = same.copy()
        for back in range(1, PLATEAU - 1):
            equal[back:] &= same[:-back]
            equal[:back] = False
        return _Blocks(cut.min(axis=1), cut.max(axis=1), noise, equal[start:].reshape(whole, self.block, c).any(axis=1))

    def _judge(self, blocks: _Blocks, b: int) -> list[Finding]:
        low, high, noise = blocks.low[b], blocks.high[b], blocks.noise[b]
        size = high - low
        smooth = size > np.maximum(MOVES * self._step, SMOOTH * noise)
        lively = (size > MOVES * self._step) & (size > LIVELY * self._usual) & (self._usual > 0)
        stuck = self._stuck(blocks, b, smooth, smooth | lively)
        clipped = self._clipped(blocks, b)
        kinds: list[Kind | None] = [
            "saturated" if c else "stuck" if s else None for s, c in zip(stuck.tolist(), clipped.tolist(), strict=True)
        ]
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        moved = (size > MOVES * self._step) & (size > 0)
        self._usual = np.maximum(FADE * self._usual, np.where(moved, size, 0.0))
        pairs = enumerate(zip(kinds, self._kinds, strict=True))
        changed = [Finding(self._done, channel, now) for channel, (now, was) in pairs if now != was]
        self._kinds = kinds
        return changed

    def _stuck(self, blocks: _Blocks, b: int, smooth: BoolArray, moving: BoolArray) -> BoolArray:
        """(c,) outputs that have stood still for too long while others moved."""
        low, high = blocks.low[b], blocks.high[b]
        run_low, run_high = np.minimum(self._run_low, low), np.maximum(self._run_high, high)
        still = run_high - run_low <= 1.01 * self._step
        began = still & (self._still == 0)
        self._speed = np.where(began, self._speed_before(b), self._speed)
        known = self._usual > 0
        soon = np.maximum(max(SHORTEST, self._window / 4), PATIENT * self._longest)
        abrupt = self._speed * self._still >= ABRUPT * self._step
        least = np.where(known & abrupt, np.minimum(soon, self._window), np.maximum(soon, self._window))
        ended = ~still & (self._still < least)
        self._longest = np.where(ended, np.maximum(self._longest, self._still), self._longest)
        self._run_low, self._run_high = np.where(still, run_low, low), np.where(still, run_high, high)
        # one that never moved is judged by motion beyond doubt only
        others = np.where(known, moving.sum() - moving, smooth.sum() - smooth) > 0
        self._still = np.where(still & ~self._inputs, self._still + self.block * others, 0.0)
        return np.asarray((self._still >= least) & (self._still > 0))

    def _speed_before(self, b: int) -> FloatArray:
        """(c,) how fast each channel went before block b, a sample; its own first block may hold the stop."""
        at = self._context + b * self.block
        x = self._pending[max(0, at - ENTRY) : at + 1]
        return np.asarray(np.abs(x[-1] - x[0]) / max(len(x) - 1, 1))

    def _clipped(self, blocks: _Blocks, b: int) -> BoolArray:
        """(c,) channels with a flat top or bottom at the extreme of all readings so far, entered too fast."""
        clipped = np.zeros(len(self._step), dtype=bool)
        reach = 0.5 * self._step
        extreme = (blocks.high[b] >= self._high - reach) | (blocks.low[b] <= self._low + reach)
        for channel in np.flatnonzero(blocks.equal[b] & extreme).tolist():
            at = self._context + b * self.block
            x = self._pending[max(0, at - PLATEAU) : at + self.block, channel]
            ends = (min(self._low[channel], blocks.low[b, channel]), max(self._high[channel], blocks.high[b, channel]))
            grain = max(float(self._step[channel]), float(blocks.noise[b, channel]))
            lasting = self._kinds[channel] == "saturated" and self._still[channel] < self._window
            clipped[channel] = lasting and bool(np.all(x[-self.block :] == x[-1]))
            clipped[channel] |= _flat(x, ends, grain)
        return clipped


def _flat(x: FloatArray, ends: tuple[float, float], grain: float) -> bool:
    """Tell whether readings run into one of two ends and stay there, faster than a rounded peak could."""
    for end, direction in zip(ends, (-1.0, 1.0), strict=True):
        for start, stop in runs(np.asarray(np.abs(x - end) <= 0.5 * grain)):
            if stop - start >= PLATEAU and start >= 2 and np.ptp(x[start:stop]) == 0:
                speed = direction * (x[start - 1] - x[start - 2])
                if speed * (stop - start) > OVERSHOOT * grain:
                    return True
    return False
