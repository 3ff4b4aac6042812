"""Outputs that stand still while others move: stuck, at a turning point, or too coarse for so small a motion.

What a channel would have shown is told by the others: how far they went since it stopped, as a share of how
far they went before, against how many steps of its own it made then. A sine within two of its steps S goes on
elsewhere for 2.8 / sqrt(S) of the way from end to end, in the worst phase. With few steps that share is no
less than one, and such a channel is never called stuck.
"""

import numpy as np

from agent.numerics.preprocessing import tuning
from agent.types import BoolArray, FloatArray, IntArray


class Standing:
    """Watches c channels, block by block.

    Args:
        inputs: (c,) which channels are inputs; those may stand still while the rig moves.
        kinds: (c,) number of the quantity that each channel shows.
        window, block: samples of the estimator's window, and of a block.
    """

    def __init__(self, inputs: BoolArray, kinds: IntArray, window: int, block: int) -> None:
        c = len(inputs)
        self.still = np.zeros(c)  # samples for which others moved since each channel stopped
        self._inputs, self._window, self._block = inputs, window, block
        self._alike = kinds[:, None] == kinds
        # a force tells of no course; it speaks only where no other output does
        shown_by = ~inputs if np.sum(~inputs) > 1 else np.ones(c, dtype=bool)
        self._others = shown_by & ~np.eye(c, dtype=bool)
        self._usual, self._longest, self._speed = np.zeros(c), np.zeros(c), np.zeros(c)
        self._called = np.zeros(c, dtype=bool)
        self._low, self._high = (
            np.full(c, np.inf),
            np.full(c, -np.inf),
        )  # of the standstill, else of the newest block
        self._chunks = np.stack(
            [np.full((2, c), np.inf), np.full((2, c), -np.inf)]
        )  # lowest, highest; older, newer
        self._blocks = 0
        self._way = np.zeros((c, c))  # what the others used to go when each channel stopped
        self._steps = np.zeros(c)  # and how many steps it made itself then
        self._since = np.zeros((2, c, c))  # lowest, highest of the others since then
        self._leg = np.zeros((2, c, c))  # and since they last had gone half of their way
        self._trips, self._course = np.zeros((c, c)), np.zeros((c, c))

    def skip(self, low: FloatArray, high: FloatArray, noise: FloatArray, step: FloatArray) -> None:
        """Take blocks (N, c) in which no channel stands still."""
        size = high - low
        stirred = np.any(self._smooth(size, noise, step), axis=1)
        after = np.cumsum(stirred[::-1])[::-1] - stirred
        faded = (size * tuning.FADE ** after[:, None]).max(axis=0)
        self._usual = np.maximum(self._usual * tuning.FADE ** int(stirred.sum()), faded)
        self._low, self._high = low[-1], high[-1]
        start = 0
        while start < len(low):
            stop = min(start + tuning.CHUNK - self._blocks % tuning.CHUNK, len(low))
            self._remember(low[start:stop].min(axis=0), high[start:stop].max(axis=0), stop - start)
            start = stop

    def assess(
        self, low: FloatArray, high: FloatArray, noise: FloatArray, step: FloatArray, speed: FloatArray
    ) -> BoolArray:  # fmt: skip
        """Take one block: (c,) outputs that have stood still for too long while others moved.

        speed (c,): how fast each went before the block, a sample.
        """
        size = high - low
        smooth = self._smooth(size, noise, step)
        known = self._usual > tuning.MOVES * step
        lively = (size > tuning.MOVES * step) & (size > tuning.LIVELY * self._usual) & known
        run_low = np.minimum(self._low, low)
        run_high = np.maximum(self._high, high)
        still = (run_high - run_low <= 1.01 * step) & ~self._inputs
        self._begin(still & (self.still == 0), np.maximum(speed - step / 16.0, 0.0), step)
        self._follow(low, high)
        least = self._least(step, known)
        enough = self._others_went(step)
        ended = ~still & (self.still > 0)
        learnt = np.minimum(np.minimum(self.still, least), tuning.LONGEST * self._window)
        self._longest = np.where(ended, np.maximum(self._longest, learnt), self._longest)
        self._low, self._high = np.where(still, run_low, low), np.where(still, run_high, high)
        # one that never moved is tested on motion beyond doubt only
        moving = smooth | lively
        others = np.where(known, moving.sum() - moving, smooth.sum() - smooth) > 0
        self.still = np.where(still, self.still + self._block * others, 0.0)
        self._usual = np.maximum(self._usual * (tuning.FADE if smooth.any() else 1.0), size)
        self._remember(np.where(still, np.inf, low), np.where(still, -np.inf, high), 1)
        self._called = still & (self._called | ((self.still >= least) & enough))
        return self._called

    def _smooth(self, size: FloatArray, noise: FloatArray, step: FloatArray) -> BoolArray:
        return np.asarray(size > np.maximum(tuning.MOVES * step, tuning.SMOOTH * noise))

    def _remember(self, low: FloatArray, high: FloatArray, blocks: int) -> None:
        self._chunks[0, 1] = np.minimum(self._chunks[0, 1], low)
        self._chunks[1, 1] = np.maximum(self._chunks[1, 1], high)
        self._blocks += blocks
        if self._blocks % tuning.CHUNK == 0:
            moved = self.still == 0
            self._chunks[:, 0, moved] = self._chunks[:, 1, moved]
            self._chunks[0, 1, moved], self._chunks[1, 1, moved] = np.inf, -np.inf

    def _begin(self, began: BoolArray, speed: FloatArray, step: FloatArray) -> None:
        if not began.any():
            return
        self._speed = np.where(began, speed, self._speed)
        went = self._chunks[1].max(axis=0) - self._chunks[0].min(axis=0)
        went = np.maximum(np.where(np.isfinite(went), went, 0.0), self._usual)
        self._way[began] = went
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = np.where(went > 0, went / step, 0.0)
        self._steps = np.where(began, steps, self._steps)
        for ends in (self._since, self._leg):
            ends[0, began], ends[1, began] = np.inf, -np.inf
        self._trips[began], self._course[began] = 0, went

    def _follow(self, low: FloatArray, high: FloatArray) -> None:
        """Follow the others since each channel stopped."""
        for ends in (self._since, self._leg):
            np.minimum(ends[0], low, out=ends[0])
            np.maximum(ends[1], high, out=ends[1])
        gone = self._leg[1] - self._leg[0] >= 0.5 * self._course
        self._trips += gone
        # one that goes ever further has not gone back and forth
        range_ = self._since[1] - self._since[0]
        further = range_ > tuning.MORE * self._course
        self._trips[further], self._course[further] = 0, range_[further]
        gone |= further
        self._leg[:, gone] = np.stack(
            [np.broadcast_to(low, gone.shape)[gone], np.broadcast_to(high, gone.shape)[gone]]
        )

    def _least(self, step: FloatArray, known: BoolArray) -> FloatArray:
        """(c,) samples of standstill that are too many, others having moved."""
        soon = np.maximum(max(tuning.SHORTEST, self._window / 4), tuning.PATIENT * self._longest)
        abrupt = self._speed * self.still >= tuning.ABRUPT * step
        return np.where(known & abrupt, np.minimum(soon, self._window), np.maximum(soon, self._window))

    def _others_went(self, step: FloatArray) -> BoolArray:
        """(c,) some other channel went so far that each one, if sound, would have moved."""
        range_ = self._since[1] - self._since[0]
        share = tuning.FURTHER / np.sqrt(np.maximum(self._steps, 1e-9))
        by_range = (share[:, None] <= tuning.WIDE) & (range_ >= share[:, None] * self._way)
        often = self._trips >= tuning.TRIPS
        by_trips = often & (self._steps[:, None] >= tuning.FEWEST)
        # where nothing is known of a channel, one of its kind must have gone far in its steps; without, back
        # and forth
        counted = self._alike & (step > 0)[:, None]
        never = (self._steps <= 1.01)[:, None] & np.where(
            counted, range_ >= tuning.APART * step[:, None], often
        )
        went = never | ((by_range | by_trips) & (self._way > 0))
        return np.asarray((went & self._others).any(axis=1))
