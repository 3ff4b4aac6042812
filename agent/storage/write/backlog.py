"""Records waiting for the disk: bounded, and of what does not fit the oldest estimates go, never an alarm.

And how long it takes from a sample to its row on the disk.
"""

import time
from bisect import bisect_left
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from agent.records import ClockRecord, Record
from agent.storage.tables.estimates import joined_runs
from agent.storage.tuning import BOUNDS_S, FEW_CELLS, LONGEST_S, SHORTEST_S
from agent.types import AlarmTransition, EstimateBatch


@dataclass(slots=True)
class Histogram:
    """Counts of what was observed, a bin each, and the sum."""

    counts: list[int] = field(default_factory=lambda: [0] * (len(BOUNDS_S) + 1))
    sum_s: float = 0.0

    def observe(self, seconds: float) -> None:
        """Count one value."""
        self.counts[bisect_left(BOUNDS_S, seconds)] += 1
        self.sum_s += seconds

    def cumulated(self) -> list[tuple[str, int]]:
        """Return each bin's upper end, as text, with the count of all values up to it."""
        ends = [*map(str, BOUNDS_S), "+Inf"]
        return [(end, sum(self.counts[: i + 1])) for i, end in enumerate(ends)]


def cells_of(record: Record) -> int:
    """Return how many rows a record makes."""
    return len(record) * len(record.parameters) if isinstance(record, EstimateBatch) else 1


class Backlog:
    """What one rig has to store, in order.

    Args:
        most_cells: rows kept at most; alarm transitions, and what stamps mean, are kept beyond it.
    """

    def __init__(self, most_cells: int) -> None:
        self._most = most_cells
        self._records: deque[Record] = deque()
        self._cells = 0
        self._small = 0
        self.dropped: Counter[str] = Counter()

    def __len__(self) -> int:
        return self._cells

    def add(self, records: Sequence[Record], reason: str) -> None:
        """Append records; reason: why rows are waiting, under which those pushed out are counted."""
        self._records.extend(records)
        self._cells += sum(map(cells_of, records))
        self._small += len(records)
        if self._small > FEW_CELLS:
            self._join()
        while self._cells > self._most and self._drop_oldest(reason):
            pass

    def take(self) -> list[Record]:
        """Return everything that waits, and wait for nothing any more."""
        taken = list(self._records)
        self._records.clear()
        self._cells = self._small = 0
        return taken

    def _join(self) -> None:
        batches = [r for r in self._records if isinstance(r, EstimateBatch)]
        others = [r for r in self._records if not isinstance(r, EstimateBatch)]
        self._records = deque([*joined_runs(batches), *others])
        self._small = 0

    def _drop_oldest(self, reason: str) -> bool:
        for place, record in enumerate(self._records):
            if not isinstance(record, AlarmTransition | ClockRecord):
                self._drop(place, record, reason)
                return True
        return False

    def _drop(self, place: int, record: Record, reason: str) -> None:
        """Drop a record, but of estimates only the instants in excess: joined ones may be all that waits."""
        gone = cells_of(record)
        many = (
            0
            if not isinstance(record, EstimateBatch)
            else ceil((self._cells - self._most) * len(record) / gone)
        )
        if isinstance(record, EstimateBatch) and many < len(record):
            self._records[place] = record.part(np.arange(many, len(record)))
            gone -= cells_of(self._records[place])
        else:
            del self._records[place]
        self._cells -= gone
        self.dropped[reason] += gone


class Pause:
    """How long to leave a failing disk alone: 0.2 s, doubling to 5 s."""

    def __init__(self) -> None:
        self.cause: str | None = None
        self.length_s = SHORTEST_S
        self._since = self._last = 0.0

    def failed(self, cause: str) -> None:
        now = time.monotonic()
        if self.cause is None:
            self._since = now
            self.length_s = SHORTEST_S / 2
        self.cause, self._last = cause, now
        self.length_s = min(LONGEST_S, 2 * self.length_s)

    def over(self) -> bool:
        return time.monotonic() >= self._last + self.length_s

    def passed(self) -> tuple[str, float]:
        """Forget the failure; return its cause and how long it lasted, s."""
        cause, self.cause = self.cause or "", None
        return cause, time.monotonic() - self._since
