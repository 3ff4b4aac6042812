"""Which readings of a stream are missing, and what windows that lack some say.

Such windows are solved on their samples, with the missing readings as unknowns (`bridge`): the block summaries of
complete windows would believe what was filled in.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.fitting.fit import Linearised
from agent.numerics.preprocessing.bridge import Bridge, bridge_over

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
NO = -1
"""No row."""
MOST = 0.1
"""Share of a window's samples that may lack readings; beyond it a window says too little for what it costs."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What one window says about theta - theta_r, its missing readings being unknowns.

    Attributes:
        delta: (q,).
        covariance: (q, q) for unit noise variance; inf on the diagonal where nothing is known.
        information: (q, q) its inverse.
        residual: sum of squares left.
        free: degrees of freedom that the missing readings cost.
    """

    delta: FloatArray
    covariance: FloatArray
    information: FloatArray
    residual: float
    free: int


def answer(here: Linearised, free: int) -> Answer:
    """Solve a linearised window by orthogonal factors."""
    q = here.psi.shape[1]
    information = here.psi.T @ here.psi
    norms = np.linalg.norm(here.psi, axis=0)
    if not np.all(np.isfinite(norms)):
        return Answer(np.full(q, np.nan), np.full((q, q), np.inf), np.zeros((q, q)), np.inf, free)
    scaled = here.psi / np.where(norms > 0, norms, 1.0)
    left, values, right = np.linalg.svd(scaled, full_matrices=False)
    if not norms.all() or values[-1] <= 1e-7 * values[0]:
        return Answer(np.full(q, np.nan), np.full((q, q), np.inf), information, here.cost, free)
    root = (right.T / values) / norms[:, None]
    fitted = left.T @ here.e
    residual = max(here.cost - float(fitted @ fitted), 0.0)
    return Answer(root @ fitted, root @ root.T, information, residual, free)


class Lacking:
    """The missing readings of a segment, by sample and channel; outputs is the number of channels that are outputs.

    Inputs in doubt count as they were read until they are taken for spikes: then they lack as well, and nothing is
    known of them. spikes counts the samples of that kind, over all segments, of which nothing else was missing.
    """

    def __init__(self, outputs: int) -> None:
        self._outputs = outputs
        self.spikes = 0
        self.forget()

    def forget(self) -> None:
        """Begin a new segment."""
        self._sample: IntArray = np.zeros(0, dtype=np.int64)
        self._channel: IntArray = np.zeros(0, dtype=np.int64)
        self._doubtful: IntArray = np.zeros((0, 3), dtype=np.int64)  # sample, channel, row that took it for a spike

    def append(self, index: int, missing: BoolArray) -> None:
        """Note what is missing (N, p+m) of the samples that begin with number `index`."""
        sample, channel = np.nonzero(missing)
        if len(sample):
            self._sample = np.concatenate([self._sample, sample + index])
            self._channel = np.concatenate([self._channel, channel])

    def doubt(self, index: int, suspect: BoolArray) -> None:
        """Note inputs (N, p+m) that may be spikes, of the samples that begin with number `index`."""
        sample, channel = np.nonzero(suspect)
        rows = np.full(len(sample), NO)
        self._doubtful = np.vstack([self._doubtful, np.column_stack([sample + index, channel, rows])])

    def any(self) -> bool:
        """Tell whether anything lacks or is in doubt."""
        return bool(len(self._sample) or len(self._doubtful))

    def doubts(self, stop: int, window: int) -> bool:
        """Tell whether a window that ends before sample `stop` holds inputs in doubt."""
        return bool(self._open(stop, window).any())

    def take_for_spikes(self, stop: int, window: int) -> None:
        """Take the inputs in doubt of a window that ends before sample `stop` for spikes."""
        taken = self._open(stop, window)
        self.spikes += self._alone(taken)
        self._doubtful[taken, 2] = stop - 1

    def take_back(self, after: int) -> None:
        """Believe inputs again that rows after number `after` took for spikes."""
        back = self._doubtful[:, 2] > after
        self.spikes -= self._alone(back)
        self._doubtful[back, 2] = NO

    def _open(self, stop: int, window: int) -> BoolArray:
        sample, row = self._doubtful[:, 0], self._doubtful[:, 2]
        return np.asarray((row == NO) & (sample >= stop - window) & (sample < stop))

    def _alone(self, which: BoolArray) -> int:
        return len(np.setdiff1d(self._doubtful[which, 0], self._sample))

    def trim(self, oldest: int) -> None:
        """Forget what lies before a sample."""
        self._doubtful = self._doubtful[self._doubtful[:, 0] >= oldest]
        if len(self._sample) and self._sample[0] < oldest:
            kept = self._sample >= oldest
            self._sample, self._channel = self._sample[kept], self._channel[kept]

    def count(self, index: IntArray, window: IntArray | int) -> IntArray:
        """Return how many samples (N,) of windows ending at samples index (N,) lack some reading."""
        instants = np.unique(np.concatenate([self._sample, self._spiked[:, 0]]))
        stop = np.searchsorted(instants, index, side="right")
        return np.asarray(stop - np.searchsorted(instants, index - window, side="right"), dtype=np.int64)

    def bridge(self, v: FloatArray, stop: int) -> Bridge | None:
        """Return what a window v (W, p+m) lacks that ends before sample `stop`; None when it is complete."""
        start = stop - len(v)
        missing, false = np.zeros(v.shape, dtype=bool), np.zeros(v.shape, dtype=bool)
        for mask, sample, channel in ((missing, self._sample, self._channel), (false, *self._spiked.T[:2])):
            inside = (sample >= start) & (sample < stop)
            mask[sample[inside] - start, channel[inside]] = True
        found = bridge_over(v, missing | false, self._outputs)
        if found is None or not false.any():
            return found
        # what stands in the place of a spike says nothing of what was there
        return replace(found, sd=np.where(false[found.sample, found.channel], np.inf, found.sd))

    @property
    def _spiked(self) -> IntArray:
        """(k, 3) inputs that were taken for spikes."""
        return np.asarray(self._doubtful[self._doubtful[:, 2] != NO])
