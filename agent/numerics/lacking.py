"""Which readings of a stream are missing, and what windows that lack some say.

Such windows are solved on their samples, with the missing readings as unknowns (`bridge`): the block summaries of
complete windows would believe what was filled in.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from agent.numerics.bridge import Bridge, bridge_over
from agent.numerics.fit import Linearised

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
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
    scaled = here.psi / np.where(norms > 0, norms, 1.0)
    left, values, right = np.linalg.svd(scaled, full_matrices=False)
    if not norms.all() or values[-1] <= 1e-7 * values[0]:
        return Answer(np.full(q, np.nan), np.full((q, q), np.inf), information, here.cost, free)
    root = (right.T / values) / norms[:, None]
    fitted = left.T @ here.e
    residual = max(here.cost - float(fitted @ fitted), 0.0)
    return Answer(root @ fitted, root @ root.T, information, residual, free)


class Lacking:
    """The missing readings of a segment, by sample and channel; outputs is the number of channels that are outputs."""

    def __init__(self, outputs: int) -> None:
        self._outputs = outputs
        self.forget()

    def forget(self) -> None:
        """Begin a new segment."""
        self._sample: IntArray = np.zeros(0, dtype=np.int64)
        self._channel: IntArray = np.zeros(0, dtype=np.int64)

    def append(self, index: int, missing: BoolArray) -> None:
        """Note what is missing (N, p+m) of the samples that begin with number `index`."""
        sample, channel = np.nonzero(missing)
        if len(sample):
            self._sample = np.concatenate([self._sample, sample + index])
            self._channel = np.concatenate([self._channel, channel])

    def trim(self, oldest: int) -> None:
        """Forget what lies before a sample."""
        if len(self._sample) and self._sample[0] < oldest:
            kept = self._sample >= oldest
            self._sample, self._channel = self._sample[kept], self._channel[kept]

    def count(self, index: IntArray, window: IntArray | int) -> IntArray:
        """Return how many samples (N,) of windows ending at samples index (N,) lack some reading."""
        instants = np.unique(self._sample)
        stop = np.searchsorted(instants, index, side="right")
        return np.asarray(stop - np.searchsorted(instants, index - window, side="right"), dtype=np.int64)

    def bridge(self, v: FloatArray, stop: int) -> Bridge | None:
        """Return what a window v (W, p+m) lacks that ends before sample `stop`; None when it is complete."""
        start = stop - len(v)
        inside = slice(*np.searchsorted(self._sample, [start, stop]).tolist())
        if inside.start == inside.stop:
            return None
        missing = np.zeros(v.shape, dtype=bool)
        missing[self._sample[inside] - start, self._channel[inside]] = True
        return bridge_over(v, missing, self._outputs)
