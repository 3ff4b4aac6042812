"""A fault in the numerics of one rig is that rig's: it is told, counted and survived, and no other rig notices.

The numerics of the rig (quality, estimation) start anew; numbers, clocks and alarms go on. Samples on their way when it
happened are counted as `failure`, as are those of the pause after it, which grows while the fault comes back.
"""

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeGuard, TypeVar

from agent.blocks.acquisition.interface import Label
from agent.blocks.estimation import ESTIMATION, FAILURE
from agent.config import RigConfig
from agent.runtime.pipeline import Pipeline
from agent.types import AlarmTransition, EstimateBatch, HealthEvent, Reason, Record, Status
from drivers.port import SampleBlock

PAUSE_NS = 1_000_000_000, 60_000_000_000
"""Shortest and longest pause after a fault."""

T = TypeVar("T")
log = logging.getLogger(__name__)


class IsolatedPipeline(Pipeline):
    """A pipeline that raises nothing: an exception in it becomes records, and numerics that start anew."""

    def __init__(
        self, config: RigConfig, resolution: Mapping[str, float], sources: Mapping[str, Mapping[str, str]]
    ) -> None:
        super().__init__(config, resolution, sources)
        self._given: Counter[str] = Counter()
        self._lost: dict[str, Counter[str]] = {source: Counter() for source in sources}
        self._reported: list[Record] = []
        self._standing = False
        self._now_ns, self._resumes_ns = 0, 0
        self._pause_ns = PAUSE_NS[0]

    def restore_failure(self, standing: Sequence[str]) -> None:
        """Go on with the source alarms that the run before left standing, as far as they are this one's."""
        self._standing = ESTIMATION in standing

    def take(self, source: str, block: SampleBlock, modulus: int | None, label: Label | None) -> None:
        """Take a block, as every pipeline does; in the pause after a fault its samples are only counted."""
        self._given[source] += len(block)
        self._now_ns = block.arrival_ns
        if self._now_ns < self._resumes_ns:
            self._settle(source)
        else:
            self._kept(partial(super().take, source, block, modulus, label))

    def compute(self) -> list[Record]:
        """Return what the blocks taken lead to, and what went wrong."""
        return self._with_news(self._kept(super().compute))

    def finish(self) -> list[Record]:
        """Return what the last samples lead to, and what went wrong."""
        return self._with_news(self._kept(super().finish))

    def ends(self, name: str) -> tuple[int, Counter[str]]:
        """How many of a source's samples were used or wait, and those refused after it, faults included."""
        used, rejected = super().ends(name)
        return used, rejected + self._lost[name]

    def _kept(self, work: Callable[[], T]) -> T | None:
        """Do some of the pipeline's work; None where it failed."""
        try:
            return work()
        except Exception as error:
            # whatever fails in here, the other rigs go on: it is told, counted and tried again
            log.exception("%s: the estimation failed and starts anew", self.config.rig.name)
            self._fail(f"{type(error).__name__}: {error}")
            return None

    def _with_news(self, records: Sequence[Record] | None) -> list[Record]:
        found, self._reported = [*self._reported, *(records or ())], []
        failed = next((record for record in found if _failed(record)), None)
        if failed is not None and not self._standing:
            self._standing = True
            found.append(self._alarm(failed.message, lost=True))
        elif self._standing and any(_estimates(record) for record in found):
            self._standing = False
            found.append(self._alarm("estimates come again", lost=False))
        return found

    def _fail(self, words: str) -> None:
        """Start the numerics anew after a pause, count what was on its way, and say so."""
        again = self._resumes_ns > 0 and self._now_ns - self._resumes_ns < PAUSE_NS[1]
        self._pause_ns = min(2 * self._pause_ns, PAUSE_NS[1]) if again else PAUSE_NS[0]
        self._resumes_ns = self._now_ns + self._pause_ns
        message = f"the estimation failed and starts anew after {self._pause_ns / 1e9:g} s: {words}"
        self._reported.append(HealthEvent(self.config.rig.name, ESTIMATION, self.newest_ns, FAILURE, message))
        if not self._standing:
            self._standing = True
            self._reported.append(self._alarm(message, lost=True))
        self._renew()
        for source in self._lost:
            self._settle(source)

    def _renew(self) -> None:
        """Make the numerics anew; what was used or refused stays counted, what was on its way will not come out."""
        self._taken.clear()
        self.acquisition.lose(FAILURE, self.through())
        self.begin_numerics()
        self.sensor_alarms.start_anew()

    def _settle(self, source: str) -> None:
        """Count the samples of a source that ended nowhere: the fault lost them."""
        used, rejected = self.ends(source)
        ended = used + rejected.total() + self.acquisition.sources[source].refusals().total()
        self._lost[source][FAILURE] += max(0, self._given[source] - ended)

    def _alarm(self, message: str, *, lost: bool) -> AlarmTransition:
        return AlarmTransition(
            rig=self.config.rig.name, kind="source", parameter=ESTIMATION, priority="high", t_ns=self.newest_ns,
            from_state="NORM" if lost else "UNACK", to_state="UNACK" if lost else "RTNUN",
            cause="raise" if lost else "clear", message=message,
        )  # fmt: skip


def _failed(record: Record) -> TypeGuard[HealthEvent]:
    """Tell whether a method failed inside its block, which goes on by itself."""
    return isinstance(record, HealthEvent) and (record.source, record.cause) == (ESTIMATION, FAILURE)


def _estimates(record: Record) -> bool:
    if not isinstance(record, EstimateBatch):
        return False
    nothing = (record.status == Status.WARMING) | (record.reason == Reason.DIVERGED)
    return not bool(nothing.all())
