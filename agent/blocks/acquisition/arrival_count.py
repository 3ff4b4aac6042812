"""Which sample is it, where only its arrival says so: samples are counted, and time tells of missing ones.

An arrival is never early and often late: rounding each one by itself makes repeats and gaps of what is only
jitter. So samples follow one another, and a line of the most punctual arrivals says when the next one is due.
Only arrivals that are later than is usual by most of a sample, or that stay late for a while, tell of samples
that were lost. Where samples have no receipt of their own, the newest of a block is up to a sample old when
it is read: of a single lost one that tells late or not at all.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from agent.blocks import tuning
from agent.types import IntArray
from drivers.port import SampleBlock


@dataclass(slots=True)
class ArrivalCount:
    """Numbers the samples of one source by their arrival.

    rate_hz: the nominal rate. Lateness is in samples, times are of the monotonic clock, ns.
    """

    rate_hz: float
    _number: int = -1
    _line: float = 0.0  # when the newest sample was due
    _usual: deque[float] = field(default_factory=lambda: deque([1.0], maxlen=tuning.USUAL))
    _late_since: float | None = None
    _least_late: float = np.inf
    _stayed: int = 0

    def take(self, block: SampleBlock, origin_ns: int | None) -> tuple[IntArray, int]:
        """Return numbers (n,) of a block's samples and when number 0 was received: origin_ns, if given."""
        if block.received_ns is not None:
            found = []
            for received in block.received_ns.tolist():
                origin_ns = round(self._begin(1, received, origin_ns))
                found.append(self._arrive(1, received, origin_ns, own=True))
            return np.concatenate(found), origin_ns or 0
        origin_ns = round(self._begin(len(block), block.arrival_ns, origin_ns))
        return self._arrive(len(block), block.arrival_ns, origin_ns, own=False), origin_ns

    def _begin(self, count: int, now_ns: int, origin_ns: int | None) -> float:
        """Put the first sample of all where its receipt is; return the receipt of number 0."""
        period = 1e9 / self.rate_hz
        first_ns = now_ns - (count - 1) * period
        origin = first_ns if origin_ns is None else float(origin_ns)
        if self._number < 0:
            self._number = max(round((first_ns - origin) / period), 0) - 1
            self._line = first_ns - period
        return origin

    def _arrive(self, count: int, now_ns: int, origin_ns: int, *, own: bool) -> IntArray:
        """Return numbers (count,) of samples that arrived together; more than time allows are repeats."""
        period = 1e9 / self.rate_hz
        late = (now_ns - self._line) / period - count
        skipped = self._skipped(late, now_ns, own=own)
        late -= skipped
        self._usual.append(late)
        self._line = now_ns - max(0.0, late - min(max(late, 0.0), tuning.LEAK * count)) * period
        first = self._number + skipped + 1
        elapsed = (now_ns - origin_ns) / period
        most = int(elapsed + tuning.BACKLOG_S * self.rate_hz + tuning.FASTER * elapsed)
        numbers = np.minimum(np.arange(first, first + count, dtype=np.int64), max(most, self._number))
        self._number = int(numbers[-1])
        return numbers

    def _skipped(self, late: float, now_ns: int, *, own: bool) -> int:
        """Return how many samples an arrival so late says were lost before it."""
        usual = max(*self._usual, 0.0 if own else tuning.PAUSE_READ_S * self.rate_hz)
        if late >= usual + tuning.CLEAR:
            self._late_since = None
            return max(1, round(late - float(np.median(self._usual))))
        # a block's newest sample may be a sample old at each reading
        age = 0.0 if own else 1.0
        if late < max(age + 0.1, tuning.CLEAR):
            self._late_since = None
            return 0
        if self._late_since is None:
            self._late_since, self._least_late, self._stayed = now_ns, np.inf, 0
        self._least_late, self._stayed = min(self._least_late, late), self._stayed + 1
        if self._stayed < tuning.STAYS_LATE_SAMPLES or now_ns - self._late_since < tuning.STAYS_LATE_S * 1e9:
            return 0
        self._late_since = None
        return round(self._least_late - age / 2)
