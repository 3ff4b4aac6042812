"""Channels that stopped telling: stuck at one value while others move, or clipped at the end of their range.

Judged block by block (counted from the stretch's first sample, so that results do not depend on how the
stream was cut), by what a channel usually does: a coarse channel that often stays on one step may do so
longer than a fine one. Where nothing moves nothing is stuck: standstill is no fault. What is tested is in
`standing` and `rails`.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from agent.numerics.preprocessing.rails import RAIL_ENTRY, Rails
from agent.numerics.preprocessing.rows import followed, least_of_parts
from agent.numerics.preprocessing.standing import Standing
from agent.numerics.preprocessing.tuning import ENTRY, OVERSHOOT, PLATEAU, SAME
from agent.numerics.preprocessing.wire import Wire
from agent.types import BoolArray, FloatArray, IntArray

Kind = Literal["stuck", "saturated"]


@dataclass(frozen=True, slots=True)
class Finding:
    """From sample `stop` of the stretch on a channel is known to be at fault, or (kind None) sound again."""

    stop: int
    channel: int
    kind: Kind | None


@dataclass(frozen=True, slots=True)
class _Blocks:
    """Facts of N blocks: lowest, highest, noise, step (N, c); equal (N, c) if PLATEAU readings in a row are.

    entered (N, c): the speed at which such a row was run into, a sample. rail (N, c): so fast that it may be
    the end of a range. least, most (N, c): lowest and highest with the readings before that tell of a rail.
    """

    low: FloatArray
    high: FloatArray
    noise: FloatArray
    step: FloatArray
    equal: BoolArray
    entered: FloatArray
    rail: BoolArray
    least: FloatArray
    most: FloatArray


class SensorWatch:
    """Watches the channels of a rig.

    Args:
        inputs: (c,) which channels are inputs; those may stand still while the rig moves.
        step: (c,) the wire's smallest step of each channel, SI; 0 where it has none or nobody states it.
        window: samples of the estimator's window.
        kinds: (c,) number of the quantity that each channel shows; each another where it is not given.
        commanded: (c,) inputs that are what was commanded: they stay where they are put and know no end of a
            range.
        wire: what channels come in, SI if not said.
    """

    def __init__(
        self, inputs: BoolArray, step: FloatArray, window: int, kinds: IntArray | None = None,
        commanded: BoolArray | None = None, wire: Wire | None = None,
    ) -> None:  # fmt: skip
        c = len(step)
        self._measured = np.ones(c, dtype=bool) if commanded is None else ~commanded
        self.block = int(np.clip(window // 16, 8, 64))
        self._inputs, self._window = inputs, window
        self._stated = step
        self._seen = np.full(c, np.inf)
        self._low, self._high = np.full(c, np.inf), np.full(c, -np.inf)
        self._standing = Standing(inputs, np.arange(c) if kinds is None else kinds, window, self.block)
        self._rails = Rails(inputs, Wire.in_si(c) if wire is None else wire)
        self._kinds: list[Kind | None] = [None] * c
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch; a channel that was at fault is so until it moves again."""
        # samples of context, then the block that is not whole yet
        self._pending: FloatArray = np.zeros((0, len(self._stated)))
        self._context = 0
        self._done = 0

    def take(self, v: FloatArray) -> list[Finding]:
        """Take further samples v (N, c); return what changed, in order."""
        self._pending = followed(self._pending, v)
        whole = (len(self._pending) - self._context) // self.block
        if not whole:
            return []
        blocks = self._facts(whole)
        found: list[Finding] = []
        doubtful = self._doubtful(blocks)
        b = 0
        while b < whole:
            quiet = self._quiet_until(blocks, doubtful, b)
            if quiet > b:
                self._skip(blocks, slice(b, quiet))
            else:
                quiet = b + 1
                self._done += self.block
                found += self._assess(blocks, b)
            b = quiet
        start = self._context + whole * self.block
        self._context = min(start, ENTRY)
        self._pending = self._pending[start - self._context :]
        return found

    def _doubtful(self, blocks: _Blocks) -> BoolArray:
        """(N,) blocks in which some channel stands still, or runs into what may be the end of its range.

        A force that is held runs into nothing: it rested before.
        """
        before = np.maximum.accumulate(np.vstack([self._high, blocks.high]))[:-1]
        below = np.minimum.accumulate(np.vstack([self._low, blocks.low]))[:-1]
        reach = 0.5 * blocks.step
        extreme = blocks.equal & ((blocks.high >= before - reach) | (blocks.low <= below + reach))
        extreme &= blocks.entered > 0
        still = (blocks.high - blocks.low <= 1.01 * blocks.step) & ~self._inputs
        return np.asarray((still | extreme | blocks.rail).any(axis=1))

    def _quiet_until(self, blocks: _Blocks, doubtful: BoolArray, b: int) -> int:
        """Return the next block that must be looked at."""
        if self._standing.still.any() or any(self._kinds):
            return b
        ahead = doubtful[b:]
        if self._rails.any_stopped():
            met = self._rails.met(blocks.least[b:], blocks.most[b:])
            ahead = ahead | (blocks.equal[b:] & (met | (blocks.entered[b:] > 0))).any(axis=1)
        return b + int(np.argmax(ahead)) if ahead.any() else len(doubtful)

    def _skip(self, blocks: _Blocks, which: slice) -> None:
        """Take blocks in which everything moves."""
        low, high = blocks.low[which], blocks.high[which]
        self._done += self.block * len(low)
        self._standing.skip(low, high, blocks.noise[which], blocks.step[which])
        least = low.min(axis=0)
        most = high.max(axis=0)
        self._rails.pass_by(least, most, self.block * len(low))
        self._low, self._high = np.minimum(self._low, least), np.maximum(self._high, most)

    def _facts(self, whole: int) -> _Blocks:
        start = self._context
        c = len(self._stated)
        stop = start + whole * self.block
        # channel by channel: what is asked of blocks of few channels costs ten times as much sample by sample
        x = np.ascontiguousarray(self._pending[:stop].T)
        blocks = (c, whole, self.block)
        cut = x[:, start:].reshape(blocks)
        third = np.abs(np.diff(cut, n=3, axis=2))
        # of white noise the third difference has sd sqrt(20), and its mean size is 0.8 sd
        noise = third.mean(axis=2).T / (0.8 * np.sqrt(20.0))
        change = np.diff(x, axis=1, prepend=np.inf)  # nothing is known before a stretch's first sample
        same = np.abs(change) <= SAME * np.abs(x)
        change[:, 0] = 0.0
        step = self._steps(change, same, whole)
        plateau, fastest = self._plateaus(change, same, blocks)
        rail = np.asarray(fastest > OVERSHOOT / PLATEAU * np.maximum(step, noise))
        low = least_of_parts(x[:, start:], self.block).T
        high = -least_of_parts(-x[:, start:], self.block).T
        # a row of equal readings may begin in the block before, at first in the samples of context
        context = x[:, start - RAIL_ENTRY : start] if start else x[:, :1]
        least = np.minimum(low, np.vstack([context.min(axis=1), low[:-1]]))
        most = np.maximum(high, np.vstack([context.max(axis=1), high[:-1]]))
        return _Blocks(low, high, noise, step, plateau, fastest, rail, least, most)

    def _plateaus(
        self, change: FloatArray, same: BoolArray, blocks: tuple[int, int, int]
    ) -> tuple[BoolArray, FloatArray]:
        """Return in which blocks (N, c) equal readings follow each other and how fast such a row was entered.

        The last step into it is left out: where readings rested, as a force that is held does between two
        steps, they went not at all.
        """
        equal = same.copy()
        for back in range(1, PLATEAU - 1):
            equal[:, back:] &= same[:, :-back]
            equal[:, :back] = False
        if not equal.any():
            return np.zeros(blocks[1::-1], dtype=bool), np.zeros(blocks[1::-1])
        start = self._context
        began = equal[:, PLATEAU:] & ~same[:, 1 : 1 - PLATEAU] & self._measured[:, None]
        speed = np.zeros_like(change)
        speed[:, PLATEAU:] = np.where(began, np.abs(change[:, :-PLATEAU]), 0.0)
        fastest = speed[:, start:].reshape(blocks).max(axis=2).T
        plateau = np.asarray(equal[:, start:].reshape(blocks).any(axis=2)).T & self._measured
        return plateau, fastest

    def _steps(self, change: FloatArray, same: BoolArray, whole: int) -> FloatArray:
        """Return the wire's step (N, c) known after each block: as stated, else the least single change seen.

        change, same (c, samples). A change between readings that rest before and behind it is a step; where a
        channel stops or is clipped it has moved all the time before.
        """
        c = len(self._stated)
        if self._stated.all():
            return np.broadcast_to(self._stated, (whole, c))
        alone = same[:, 2:] & ~same[:, 1:-1] & same[:, :-2]
        least = np.full((whole, c), np.inf)
        if alone.any():
            single = np.full(change.shape, np.inf)
            single[:, 2:] = np.where(alone, np.abs(change[:, 1:-1]), np.inf)
            least = single[:, self._context :].reshape(c, whole, self.block).min(axis=2).T
        seen = np.minimum.accumulate(np.vstack([self._seen, least]))[1:]
        self._seen = seen[-1]
        return np.where(self._stated > 0, self._stated, np.where(np.isfinite(seen), seen, 0.0))

    def _assess(self, blocks: _Blocks, b: int) -> list[Finding]:
        low, high, noise, step = blocks.low[b], blocks.high[b], blocks.noise[b], blocks.step[b]
        stuck = self._standing.assess(low, high, noise, step, self._speed_before(b))
        self._rails.pass_by(low, high, self.block)
        self._low, self._high = np.minimum(self._low, low), np.maximum(self._high, high)
        clipped = self._clipped(blocks, b)
        kinds: list[Kind | None] = [
            "saturated" if c else "stuck" if s else None
            for s, c in zip(stuck.tolist(), clipped.tolist(), strict=True)
        ]
        pairs = enumerate(zip(kinds, self._kinds, strict=True))
        changed = [Finding(self._done, channel, now) for channel, (now, was) in pairs if now != was]
        self._kinds = kinds
        return changed

    def _speed_before(self, b: int) -> FloatArray:
        """(c,) how fast each channel went before block b, a sample; its own first block may hold the stop."""
        at = self._context + b * self.block
        x = self._pending[max(0, at - ENTRY) : at + 1]
        return np.asarray(np.abs(x[-1] - x[0]) / max(len(x) - 1, 1))

    def _clipped(self, blocks: _Blocks, b: int) -> BoolArray:
        """(c,) channels that run into the end of their range, or stay there."""
        clipped = np.zeros(len(self._stated), dtype=bool)
        reach = 0.5 * blocks.step[b]
        extreme = (blocks.high[b] >= self._high - reach) | (blocks.low[b] <= self._low + reach)
        known = blocks.equal[b] & self._rails.known()
        for channel in np.flatnonzero((blocks.equal[b] & extreme) | blocks.rail[b] | known).tolist():
            at = self._context + b * self.block
            x = self._pending[max(0, at - RAIL_ENTRY) : at + self.block, channel]
            x = np.concatenate([np.full(RAIL_ENTRY + self.block - len(x), np.nan), x])
            grain = max(float(blocks.step[b, channel]), float(blocks.noise[b, channel]))
            ends = (float(self._low[channel]), float(self._high[channel]))
            clipped[channel] = self._rails.stopped(channel, x, ends, grain) or self._lasts(channel, x, grain)
        return clipped

    def _lasts(self, channel: int, x: FloatArray, grain: float) -> bool:
        """Tell whether a channel that reached the end of its range is there all through a block."""
        lasting = self._kinds[channel] == "saturated" and self._standing.still[channel] < self._window
        here = lasting and bool(np.all(x[-self.block :] == x[-1]))
        return here and not self._rails.rests(channel, float(x[-1]), grain)
