"""Stamps and faults of the newest samples, for rows that come a few samples after their own newest one."""

from dataclasses import dataclass, field

import numpy as np

from agent.types import BoolArray, CodeArray, IntArray, Samples

KEPT = 4
"""Samples before the current ones that rows may still come of: a quintic hold looks three ahead."""


@dataclass(slots=True)
class Recent:
    """The current samples and the last few before them."""

    _index: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _t_ns: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _reason: CodeArray = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    _spoilt: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def append(self, samples: Samples) -> None:
        """Take the current samples."""
        count = len(samples.index)
        fault = samples.fault
        reason = 0 if fault is None else int(fault.reason)
        self._index = np.concatenate([self._index[-KEPT:], samples.index])
        self._t_ns = np.concatenate([self._t_ns[-KEPT:], samples.t_ns])
        self._reason = np.concatenate([self._reason[-KEPT:], np.full(count, reason, dtype=np.uint8)])
        self._spoilt = np.concatenate([self._spoilt[-KEPT:], np.full(count, fault is not None)])

    def stamps(self, index: IntArray) -> IntArray:
        """Return the stamps (N,), ns, of samples."""
        return self._t_ns[np.searchsorted(self._index, index)]

    def faults(self, index: IntArray) -> tuple[BoolArray, CodeArray]:
        """Return at which samples (N,) a channel was at fault, and the reason to give for it."""
        at = np.searchsorted(self._index, index)
        return self._spoilt[at], self._reason[at]
