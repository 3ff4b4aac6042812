"""Which estimates are kept: the newest of each period, and everything around an alarm of the rig.

Alarms of the agent itself keep no rows: they say nothing of these, and an agent that is late because of its
load would store and send twenty times as much and be later still.
"""

from collections.abc import Sequence

import numpy as np

from agent.records import Record
from agent.storage.tables.estimates import header_of, join
from agent.storage.tuning import AFTER_S, BEFORE_S
from agent.types import AlarmTransition, BoolArray, EstimateBatch, IntArray


class Thinner:
    """Thins the records of one rig; a pure function of what it was fed, in nanoseconds of the rows' own time.

    Rows are held back for `BEFORE_S` so that those before an alarm can still be kept; a kept row is passed on
    as soon as it is known to be kept, each once. Feed the records of one pipeline step together: what is kept
    then does not depend on how the stream was cut into steps.

    Args:
        every_s: length of a period; 0 keeps everything.
    """

    def __init__(self, every_s: float) -> None:
        self._every = round(every_s * 1e9)
        self._held: EstimateBatch | None = None
        self._passed: BoolArray = np.zeros(0, dtype=bool)
        self._transitions: list[int] = []

    def feed(self, records: Sequence[Record]) -> list[Record]:
        """Return the records to keep now, estimates first."""
        if self._every <= 0:
            return list(records)
        self._transitions += [r.t_ns for r in records if isinstance(r, AlarmTransition) and not r.is_of_agent]
        kept: list[Record] = []
        for record in records:
            if isinstance(record, EstimateBatch) and len(record):
                kept += self._take_in(record)
        kept += self._release()
        kept += [r for r in records if not isinstance(r, EstimateBatch)]
        return kept

    def flush(self) -> list[Record]:
        """Return what is kept of the last, unfinished period; for the end of a run."""
        kept: list[Record] = list(self._release(last=True))
        self._held = None
        self._passed = np.zeros(0, dtype=bool)
        return kept

    def _take_in(self, batch: EstimateBatch) -> list[EstimateBatch]:
        """Add rows to those held; rows of another header (a new reference) end what is held."""
        ended: list[EstimateBatch] = []
        if self._held is not None and header_of(self._held) != header_of(batch):
            ended = self._release(last=True)
            self._held = None
            self._passed = np.zeros(0, dtype=bool)
        self._held = batch if self._held is None else join([self._held, batch])
        self._passed = np.concatenate([self._passed, np.zeros(len(batch), dtype=bool)])
        return ended

    def _release(self, *, last: bool = False) -> list[EstimateBatch]:
        """Return the held rows that are now known to be kept, and forget those too old to matter."""
        if self._held is None:
            return []
        t_ns = self._held.t_ns
        keep = self._near_alarm(t_ns) | self._newest_of_period(t_ns, last)
        fresh = keep & ~self._passed
        out = [self._held.part(fresh)] if fresh.any() else []
        self._passed |= keep
        self._forget(t_ns)
        return out

    def _near_alarm(self, t_ns: IntArray) -> BoolArray:
        near = np.zeros(len(t_ns), dtype=bool)
        for moment in self._transitions:
            near |= (t_ns >= moment - round(BEFORE_S * 1e9)) & (t_ns <= moment + round(AFTER_S * 1e9))
        return near

    def _newest_of_period(self, t_ns: IntArray, last: bool) -> BoolArray:
        """Mark the last row before each change of period; the newest row only when nothing follows."""
        period = t_ns // self._every
        newest = np.empty(len(t_ns), dtype=bool)
        newest[:-1] = period[1:] != period[:-1]
        newest[-1] = last
        return newest

    def _forget(self, t_ns: IntArray) -> None:
        assert self._held is not None  # noqa: S101 - called by _release only
        newest = int(t_ns[-1])
        # rows that are later than the newest one are of before the clock was set back
        stay = (t_ns >= newest - round(BEFORE_S * 1e9)) & (t_ns <= newest)
        stay[-1] = True
        self._held, self._passed = self._held.part(stay), self._passed[stay]
        self._transitions = [m for m in self._transitions if m + round(AFTER_S * 1e9) >= newest]
