"""The newest samples of a segment with what was lost of them."""

from collections.abc import Sequence

import numpy as np

from agent.numerics.estimator.doubts import Doubts
from agent.numerics.estimator.tuning import PLACES, SPARE
from agent.numerics.inference.noise.rounding import Rounding, RoundingErrors
from agent.numerics.inference.scatter import by_repeats
from agent.numerics.inference.spectral.columns import Window, window_of
from agent.numerics.inference.tuning import MOST_REPEATS
from agent.numerics.model.uncertain import Rig
from agent.numerics.preprocessing.bridge import Bridge, bridge_over
from agent.numerics.preprocessing.rows import rows_that_change, rows_with
from agent.numerics.window.lost import Lost
from agent.numerics.window.tail import MarkCounts, Tail
from agent.types import BoolArray, FloatArray, IntArray


class Record:
    """Samples y (N, p), u (N, m) of one unbroken stretch from number `first` on, and which were filled in."""

    def __init__(self, first: int, outputs: int, inputs: int, doubts: Doubts | None = None) -> None:
        self.first, self.p = first, outputs
        self.doubts = doubts or Doubts()
        self._samples = Tail(first, np.zeros((0, outputs + inputs)))
        self._losses = Tail(first, np.zeros((0, outputs + inputs), dtype=bool))
        self._holed, self._changed = MarkCounts(first), MarkCounts(first)  # samples, any reading or output

    @property
    def stop(self) -> int:
        """Number after the newest sample."""
        return self._samples.stop

    @property
    def _v(self) -> FloatArray:
        return self._samples.held()

    @property
    def _lost(self) -> BoolArray:
        return self._losses.held()

    def append(self, y: FloatArray, u: FloatArray, lost: BoolArray | None) -> None:
        """Take samples that follow at once; lost (N, p+m)."""
        if not len(y):
            return
        start = self.stop
        v = self._samples.more(len(y))
        for column, readings in enumerate((*y.T, *u.T)):
            v[:, column] = readings
        self._losses.more(len(y))[:] = False if lost is None else lost
        self._holed.append(np.zeros(len(y), dtype=bool) if lost is None else rows_with(lost))
        if start == self.first:
            self._changed.append(np.zeros(1, dtype=bool))  # there is none before the first
            start += 1
        self._changed.append(rows_that_change(self.outputs(start - 1, self.stop)))

    def outputs(self, start: int, stop: int) -> FloatArray:
        """Return y of samples [start, stop)."""
        return self._v[start - self.first : stop - self.first, : self.p]

    def inputs(self, start: int, stop: int) -> FloatArray:
        """Return u of samples [start, stop)."""
        return self._v[start - self.first : stop - self.first, self.p :]

    def samples(self, start: int, stop: int, inputs: int | None = None) -> FloatArray:
        """Return y and u, or the first `inputs` of it, of samples [start, stop), side by side."""
        width = None if inputs is None else self.p + inputs
        return self._v[start - self.first : stop - self.first, :width]

    def samples_with_slopes(self, start: int, stop: int, inputs: int | None = None) -> FloatArray:
        """Return the same and the inputs' change since the sample before; 0 for the stretch's first."""
        u = self.inputs(start, stop)[:, :inputs]
        before = self.inputs(start - 1, start)[:, :inputs] if start > self.first else u[:1]
        return np.hstack([self.samples(start, stop, inputs), np.diff(u, axis=0, prepend=before)])

    def lost_in(self, index: IntArray, window: int) -> IntArray:
        """Return how many samples (N,) with lost readings the windows that end at samples `index` hold."""
        return self._holed.count(index, window)

    def changes_in(self, index: IntArray, window: int) -> IntArray:
        """Return in how many samples (N,) of windows ending at samples `index` some output changes code."""
        return self._changed.count(index, window - 1)

    def rests_in(self, index: IntArray, window: int) -> BoolArray:
        """(N,) windows that end at samples `index` in which all outputs stay at their codes for half of them.

        Seen on a grid of eighths: surely if they stay for five of them.
        """
        half, eighth = window // 2, window // 8
        rests = np.array([self._changed.count(index - k * eighth, half) == 0 for k in range(5)])
        return np.asarray(rests.any(axis=0))

    def rests_at(self, newest: int, window: int) -> bool:
        """Tell the same of the window that ends with one sample."""
        return bool(self.rests_in(np.array([newest]), window)[0])

    def repeats_in(self, index: IntArray, window: int) -> FloatArray:
        """Return factors (N,) on the variance, by repeated codes, of windows that end at samples `index`."""
        return by_repeats(self.changes_in(index, window), window)

    def rounding_errors_in(
        self, index: IntArray, window: int, rounding: Rounding | None
    ) -> RoundingErrors | None:
        """Return how uneven the noise of windows that end at samples `index` is; None where it is not."""
        if rounding is None or not len(index):
            return None
        start = int(index[0]) + 1 - window
        before = min(start - self.first, MOST_REPEATS)
        return RoundingErrors(start, self.outputs(start - before, int(index[-1]) + 1), rounding, before)

    def spread_in(self, index: IntArray, window: int) -> FloatArray:
        """Return the standard deviation (N, p) of each output over windows that end at samples `index`."""
        stop = index + 1 - self.first
        start = np.maximum(stop - window, 0)
        edges = np.union1d(start, stop)
        y = self._v[edges[0] : edges[-1], : self.p]
        y = y - y[0]  # sums of squares keep their digits where a displacement stands far from zero
        pieces = [np.add.reduceat(part, edges[:-1] - edges[0], axis=0) for part in (y, y * y)]
        sums = np.concatenate([np.zeros((1, 2 * self.p)), np.cumsum(np.hstack(pieces), axis=0)])
        whole = sums[np.searchsorted(edges, stop)] - sums[np.searchsorted(edges, start)]
        mean, square = np.split(whole / window, 2, axis=1)
        return np.asarray(np.sqrt(np.maximum(square - mean**2, 0.0)))

    def quiet_in(self, index: IntArray, window: int, least: FloatArray) -> BoolArray:
        """(N,) windows that end at samples `index` in which every output spreads by less than `least` (p,).

        Two of a window's W samples that differ by d make its standard deviation d/√(2W) or more: most windows
        show so.
        """
        newest = index - self.first
        places = np.maximum(newest - np.arange(PLACES)[:, None] * (window // PLACES), 0)
        seen = self._v[places, : self.p]
        apart = seen.max(axis=0) - seen.min(axis=0)
        quiet = np.asarray((apart < np.sqrt(2 * window) * least).all(axis=1))
        if quiet.any():
            quiet[quiet] = (self.spread_in(index[quiet], window) < least).all(axis=1)
        return quiet

    def loses(self, start: int, stop: int) -> bool:
        """Whether any reading of samples [start, stop) is lost."""
        return bool(self._holed.count(np.array(stop - 1), stop - start))

    def lost_between(self, start: int, stop: int, window: int) -> Lost:
        """Return the lost readings of samples [start, stop), judged by the `window` samples before `stop`.

        What a fill-in may be wrong by is how wrong such fill-ins are elsewhere among those samples.
        """
        first = max(stop - window, self.first)
        part = slice(first - self.first, stop - self.first)
        if not self.loses(start, stop):
            return Lost.none()
        bridge = bridge_over(self._v[part], self._lost[part], self.p)
        if bridge is None:
            return Lost.none()
        sample = bridge.sample + first
        sd, doubted = self._doubted(sample, bridge)
        return Lost(sample, bridge.channel, sd, doubted).between(start, stop)

    def _doubted(self, sample: IntArray, bridge: Bridge) -> tuple[FloatArray, BoolArray]:
        """Return the prior sd (l,) of lost readings, for suspect ones their size, and which are suspect."""
        places = zip(sample.tolist(), bridge.channel.tolist(), strict=True)
        sizes = np.array([abs(self.doubts.size.get(place, 0.0)) for place in places])
        return np.maximum(bridge.sd, sizes), sizes > 0

    def restore(
        self, sample: int, taps: Sequence[tuple[int, int, float]], channel: int, change: float
    ) -> None:
        """Take a reading for read: `change` more than it was filled with, wherever it enters."""
        lost = self._lost[sample - self.first]
        if lost[channel] and lost.sum() == 1:
            self._holed.clear(sample)
        lost[channel] = False
        for offset, column, weight in taps:
            if column < self._v.shape[1] and self.first <= sample + offset < self.stop:
                self._v[sample + offset - self.first, column] += weight * change

    def resting_in(self, index: IntArray, span: int, driven: BoolArray) -> BoolArray:
        """Return which driven inputs (N, m) read one value in the `span` samples up to samples `index`."""
        newest = index - self.first
        inputs = np.flatnonzero(driven)
        oldest = np.maximum(newest - span + 1, 0)
        columns = self.p + inputs
        same = (newest >= span - 1)[:, None] & (
            self._v[newest[:, None], columns] == self._v[oldest[:, None], columns]
        )
        if same.any():
            part = slice(int(oldest.min()), int(newest.max()) + 1)
            u = self._v[part, columns]
            moves = np.cumsum(u[1:] != u[:-1], axis=0)
            moves = np.concatenate([np.zeros((1, len(inputs)), dtype=int), moves])
            same &= moves[newest - part.start] == moves[oldest - part.start]
        rests = np.zeros((len(index), len(driven)), dtype=bool)
        rests[:, inputs] = same
        return rests

    def newest_input(self, index: int, number: int) -> float:
        """Return what an input read at a sample."""
        return float(self._v[index - self.first, self.p + number])

    def late(self, newest: int, length: int, channel: int, lag: int, rig: Rig) -> Window | None:
        """Return the window of `length` samples ending at number `newest` - lag, a channel read `lag` later.

        None where samples of it are not kept, or lost.
        """
        start, stop = newest + 1 - lag - length, newest + 1 - lag
        before = start - 1 - self.first
        if before < 0 or self._lost[before : stop + lag - self.first].any():
            return None
        v = self._v[before : stop - self.first].copy()
        columns = [channel] if channel < self.p else (self.p + rig.taps_of(channel - self.p)).tolist()
        v[:, columns] = self._v[before + lag : stop + lag - self.first, columns]
        return window_of(v[1:, : self.p], v[1:, self.p :], v[0, self.p :])

    def window(self, newest: int, length: int) -> Window:
        """Return the window of `length` samples that ends with number `newest`."""
        start, stop = newest + 1 - length, newest + 1
        before = self.inputs(start - 1, start)[0] if start > self.first else None
        whole = window_of(self.outputs(start, stop), self.inputs(start, stop), before)
        part = slice(start - self.first, stop - self.first)
        bridge = bridge_over(self._v[part], self._lost[part], self.p)
        if bridge is None:
            return whole
        lost = np.column_stack([bridge.sample, bridge.channel])
        return Window(whole.y, whole.u, whole.slope, lost, self._doubted(bridge.sample + start, bridge)[0])

    def trim(self, keep: int) -> None:
        """Let go of samples older than the newest `keep`, now and then."""
        spare = len(self._v) - keep
        if spare > keep + SPARE:
            self.first += spare
            for kept in (self._samples, self._losses, self._holed, self._changed):
                kept.forget(self.first)
            self.doubts.trim(self.first)
