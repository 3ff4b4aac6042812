"""Missing or impossible readings, told from motion by their neighbours and filled for the estimator.

A spike is an isolated excursion of at most three readings: what comes before and what comes after it fit each
other and it fits neither. A longer run of large values is a change, a kink or a step is motion. Judged by
second differences in units of what they usually are, so that a random force or an impact is no spike.
Decisions need a few readings beyond the doubtful one: only where one is in doubt does the stream wait for
them, and never on how it was cut.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from agent.numerics.preprocessing.bridge import filled, lagrange, runs
from agent.numerics.preprocessing.rows import columns_with, followed, largest_in, least_of_parts, rows_with
from agent.numerics.preprocessing.tuning import (
    BLOCK,
    CLEAR,
    CONTEXT,
    CROWD,
    CROWDED,
    DOUBTFUL,
    EXCESS,
    EXCESS_OF_INPUTS,
    LONGEST_SPIKE,
    MEMORY,
    NEAR,
    STEPS,
    THIN,
    WILD,
)
from agent.types import BoolArray, FloatArray

LOOK_AHEAD = LONGEST_SPIKE + 2  # fixed by the second difference, which needs one on either side


@dataclass(frozen=True, slots=True)
class Clean:
    """Consecutive samples of which every reading is there or filled in.

    Attributes:
        v: (N, c).
        missing: (N, c) readings filled in, lost ones and spikes alike.
        spike: (N, c) those of them that were spikes.
        suspect: (N, c) inputs that look like spikes; whether they are, only the motion can tell.
    """

    v: FloatArray
    missing: BoolArray
    spike: BoolArray
    suspect: BoolArray

    def __len__(self) -> int:
        return len(self.v)

    def part(self, stop: int) -> "Clean":
        """Return the first `stop` samples."""
        return Clean(self.v[:stop], self.missing[:stop], self.spike[:stop], self.suspect[:stop])


class Cleaner:
    """Cleans one uninterrupted stretch of samples after the other.

    Args:
        inputs: (c,) which channels are inputs; those may jump (a hammer's blow), so their spikes are only
            suspected.
        step: (c,) the wire's smallest step of each channel, SI; 0 where it has none or is not known.
    """

    def __init__(self, inputs: BoolArray, step: FloatArray) -> None:
        self._inputs, self._step = inputs, step
        self._usual = np.full((MEMORY, len(step)), -1.0)  # of the newest whole blocks, over all stretches
        self._seen = np.full(len(step), np.inf)  # smallest change so far
        self._most = np.zeros(len(step))  # largest reading given away, over all stretches
        self.restart()

    def restart(self) -> None:
        """Begin a new stretch; its first sample must be complete."""
        c = len(self._step)
        self._raw = np.zeros((0, c))  # samples given away, for testing what follows, then what waits
        self._context = 0
        self._marked = np.zeros((0, c), dtype=bool)
        self._spike = np.zeros((0, c), dtype=bool)
        self._suspect = np.zeros((0, c), dtype=bool)
        self._decided = 0
        # the block that is not whole yet, with two samples before it, (c, samples)
        self._block: FloatArray = np.zeros((c, 0))
        self._limits: FloatArray = np.zeros((0, c))  # of the samples in _raw

    def take(self, v: FloatArray, *, end: bool = False) -> Clean:
        """Take further samples v (N, c), NaN where missing; return those settled, all of them at the end."""
        self._append(v)
        self._decide(end=end)
        return self._release(end=end)

    def waiting(self) -> int:
        """Return how many complete samples wait for what comes after them."""
        return int((~np.isnan(self._raw[self._context :]).any(axis=1)).sum())

    def _append(self, v: FloatArray) -> None:
        limits = self._limits_of(v)
        missing = np.isnan(v)
        nothing = np.zeros_like(missing)
        self._raw = followed(self._raw, v)
        self._limits = followed(self._limits, limits)
        self._marked = followed(self._marked, missing)
        self._spike = followed(self._spike, nothing)
        self._suspect = followed(self._suspect, nothing)

    def _limits_of(self, v: FloatArray) -> FloatArray:
        """Return the largest second difference (N, c) beyond doubt for new samples, by the blocks before."""
        # by channel, whose readings then lie side by side: all of this is several times cheaper so
        columns = np.concatenate([self._block, v.T], axis=1)
        before = self._block.shape[1]
        whole = max(0, before + len(v) - 2) // BLOCK
        first, second, third = (columns[:, place : place + whole * BLOCK : THIN] for place in range(3))
        sizes = np.abs((third - second) - (second - first)).reshape(v.shape[1], whole, BLOCK // THIN)
        known = np.concatenate([self._usual, _medians(sizes)])
        usual = np.lib.stride_tricks.sliding_window_view(known, MEMORY, axis=0).max(
            axis=2
        )  # one more than blocks
        self._usual, self._block = known[-MEMORY:], columns[:, whole * BLOCK :]
        ends = np.append(BLOCK * np.arange(1, whole + 1) + 2 - before, len(v))
        excess = np.where(self._inputs, EXCESS_OF_INPUTS, EXCESS)
        steps = self._steps(columns[:, 1 : 2 + whole * BLOCK], whole)
        limits = np.where(usual < 0, np.inf, excess * usual + STEPS * steps)
        return np.repeat(limits.T, np.diff(ends, prepend=0), axis=1).T

    def _steps(self, columns: FloatArray, whole: int) -> FloatArray:
        """Return wire steps (whole + 1, c) before each block and behind the last: the least seen, if unknown.

        A channel of text has steps that nobody states; where it rests on one, the next is no spike.
        """
        if self._step.all():
            return np.tile(self._step, (whole + 1, 1))
        changes = np.abs(columns[:, 1::THIN] - columns[:, :-1:THIN])
        least = least_of_parts(np.where(changes > 0, changes, np.inf), BLOCK // THIN).T
        seen = np.minimum.accumulate(np.vstack([self._seen, least]))
        self._seen = seen[-1]
        return np.asarray(np.where(self._step > 0, self._step, seen))

    def _decide(self, *, end: bool) -> None:
        """Mark spikes among the samples that are not decided, as far as what comes after them is there."""
        x = self._raw
        first = max(self._decided, 2)
        if len(x) > first:
            size = x[first:] - 2 * x[first - 1 : -1]
            size += x[first - 2 : -2]
            doubtful = ~(np.abs(size, out=size) <= self._limits[first:])
            for place in (np.flatnonzero(rows_with(doubtful)) + first).tolist():
                if place + LOOK_AHEAD >= len(x) and not end:
                    self._decided = place
                    return
                # a spike leaves three large second differences; the first may just pass
                self._assess(place, np.asarray(doubtful[place - first : place - first + 3].any(axis=0)))
        self._decided = len(x)

    def _assess(self, place: int, doubtful: BoolArray) -> None:
        """Look for a spike that begins at a sample, in the channels in doubt (c,)."""
        for channel in np.flatnonzero(doubtful).tolist():
            free = not (self._marked[place, channel] or self._suspect[place, channel])
            if free and (length := self._spike_at(place, channel)):
                spiked = slice(place, place + length)
                if self._inputs[channel] and not self._is_wild(spiked, channel):
                    self._suspect[spiked, channel] = not self._is_crowded(place, channel)
                else:
                    self._marked[spiked, channel] = self._spike[spiked, channel] = True

    def _is_crowded(self, place: int, channel: int) -> bool:
        """Tell if so many second differences before a sample are in doubt that the signal is like that."""
        start = max(0, place - CROWD)
        size = np.abs(np.diff(self._raw[start:place, channel], n=2))
        return int(np.count_nonzero(size > self._limits[start + 2 : place, channel])) >= CROWDED

    def _is_wild(self, spiked: slice, channel: int) -> bool:
        """Tell whether readings that stand out are beyond what the channel can have meant."""
        height = float(np.abs(self._raw[spiked, channel]).max(initial=0.0))
        limit, most = float(self._limits[spiked.start, channel]), float(self._most[channel])
        if not height > WILD * max(limit, most):
            return False  # whatever came since: searching it would cost as much as all that came, each time
        came = np.abs(self._raw[: spiked.start, channel])[~self._marked[: spiked.start, channel]]
        return bool(height > WILD * max(limit, float(came.max(initial=most))))

    def _spike_at(self, place: int, channel: int) -> int:
        """Return the length of the spike in a channel that begins at a sample; 0 where there is none."""
        x, limit = self._raw[:, channel], self._limits[place, channel]
        start = max(0, place - NEAR)
        near = slice(start, place + LOOK_AHEAD + 1)
        free = np.flatnonzero(~(self._marked[near, channel] | self._suspect[near, channel])) + start
        before, behind = free[free < place][-2:], free[free >= place]
        for length in range(1, LONGEST_SPIKE + 1):
            after = behind[length : length + 2]
            # the spike's own readings must be there, and two on either side
            if len(before) < 2 or len(after) < 2 or behind[length - 1] != place + length - 1:
                return 0
            clear = DOUBTFUL if self._inputs[channel] else CLEAR
            if _stands_out(
                x, before, range(place, place + length), after, (limit, clear), smooth=clear == CLEAR
            ):
                return length
        return 0

    def _release(self, *, end: bool) -> Clean:
        """Give away what is settled: decided, and with two readings after each that is missing."""
        stop = self._decided if end else self._settled()
        clean = self._raw.copy(order="K")
        for channel in columns_with(self._marked[:stop]):
            known = self._decided if not end else len(clean)
            clean[:known, channel] = filled(clean[:known, channel], self._marked[:known, channel])
        out = slice(self._context, stop)
        self._most = np.maximum(
            self._most, largest_in(np.where(self._marked[out], 0.0, np.abs(self._raw[out])))
        )
        released = Clean(clean[out], self._marked[out], self._spike[out], self._suspect[out])
        self._forget(max(0, stop - CONTEXT), stop)
        return released

    def _settled(self) -> int:
        stop = self._decided
        for channel in columns_with(self._marked[self._context : stop]):
            for start, after in runs(self._marked[: self._decided, channel]):
                good = int((~self._marked[after : self._decided, channel]).sum())
                if after > self._context and good < 2:
                    stop = min(stop, max(start, self._context))
        return stop

    def _forget(self, start: int, stop: int) -> None:
        self._context = stop - start
        self._decided -= start
        self._raw, self._limits = self._raw[start:], self._limits[start:]
        self._marked, self._spike = self._marked[start:], self._spike[start:]
        self._suspect = self._suspect[start:]


def _medians(sizes: FloatArray) -> FloatArray:
    """Return medians (blocks, c) of sizes (c, blocks, n); inf where half the readings or more are missing."""
    middle = np.sort(sizes)[..., sizes.shape[2] // 2].T  # NaN comes last
    return np.asarray(np.where(np.isnan(middle), np.inf, middle))


def _stands_out(
    x: FloatArray, before: NDArray[np.int64], spike: range, after: NDArray[np.int64],
    least: tuple[float, float],
    *, smooth: bool,
) -> bool:  # fmt: skip
    """Tell whether readings are far from what both sides agree on.

    least: how far they must be at either end, and how many times as far as the two sides are from each other;
    of a signal that is not smooth, each side's mean may stand for where it goes on.
    """
    first = spike[0]
    places = (*(before - first).tolist(), *(after - first).tolist())
    b1, b0, a0, a1 = (float(value) for value in (*x[before[::-1]], *x[after]))
    off = []
    for place in spike:
        w = _weights(places, place - first)
        off.append(abs(float(x[place]) - (w[0] * b0 + w[1] * b1 + w[2] * a0 + w[3] * a1)))
    if not (off[0] > least[0] and off[-1] > least[0]):
        return False
    gap = places[2] - places[1]
    ahead = b1 + (b1 - b0) / (places[1] - places[0]) * gap
    behind = a0 - (a1 - a0) / (places[3] - places[2]) * gap
    differ = max(abs(a0 - ahead), abs(b1 - behind))
    if not smooth:
        differ = min(differ, 0.5 * abs(a0 + a1 - b0 - b1))
    return bool(max(off) > least[1] * differ)


@lru_cache(maxsize=4096)
def _weights(places: tuple[int, ...], at: int) -> tuple[float, ...]:
    """Return the weights of readings at places in the polynomial through them, taken at another."""
    return tuple(lagrange(np.array(places), at).tolist())
