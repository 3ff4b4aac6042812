"""A fault in one rig's numerics is that rig's: it is reported, counted and survived, and no other notices.

The numerics of the rig (quality, estimation) start anew; numbers, clocks and alarms go on. Samples on their
way when it happened are counted as `failure`, as are those of the pause after it, which grows while the fault
comes back.
"""

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TypeGuard, TypeVar

from agent.blocks.acquisition.interface import Label
from agent.blocks.estimation import ESTIMATION, FAILURE
from agent.records import HealthEvent, Record
from agent.runtime.pipeline import Pipeline
from agent.runtime.tuning import PAUSE_NS
from agent.types import AlarmTransition, EstimateBatch, FloatArray, IntArray, Reason, Status
from drivers.port import SampleBlock

T = TypeVar("T")
log = logging.getLogger(__name__)


class IsolatedPipeline:
    """Drives a pipeline and raises nothing: an exception becomes records, and numerics that start anew."""

    def __init__(self, pipeline: Pipeline) -> None:
        self._pipeline = pipeline
        self._given = Counter(dict.fromkeys(pipeline.acquisition.sources, 0))
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
            self._kept(partial(self._pipeline.take, source, block, modulus, label))

    def take_covariates(self, t_ns: IntArray, readings: Mapping[str, FloatArray]) -> None:
        """Take readings of covariates, as every pipeline does."""
        self._kept(partial(self._pipeline.take_covariates, t_ns, readings))

    def compute(self) -> list[Record]:
        """Return what the blocks taken lead to, and what went wrong."""
        return self._with_news(self._kept(self._pipeline.compute))

    def finish(self) -> list[Record]:
        """Return what the last samples lead to, and what went wrong."""
        return self._with_news(self._kept(self._pipeline.finish))

    def _kept(self, work: Callable[[], T]) -> T | None:
        """Do some of the pipeline's work; None where it failed."""
        try:
            return work()
        except Exception as error:
            # whatever fails in here, the other rigs go on: it is reported, counted and tried again
            log.exception("%s: the estimation failed and starts anew", self._rig)
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
        self._reported.append(HealthEvent(self._rig, ESTIMATION, self._pipeline.newest_ns, FAILURE, message))
        if not self._standing:
            self._standing = True
            self._reported.append(self._alarm(message, lost=True))
        self._pipeline.begin_anew(FAILURE)
        for source in self._given:
            self._settle(source)

    def _settle(self, source: str) -> None:
        """Count the samples of a source that ended nowhere: the fault lost them."""
        self._pipeline.ledger.settle(source, self._given[source], FAILURE)

    @property
    def _rig(self) -> str:
        return self._pipeline.config.rig.name

    def _alarm(self, message: str, *, lost: bool) -> AlarmTransition:
        t_ns = self._pipeline.newest_ns
        return AlarmTransition.plain(self._rig, "source", ESTIMATION, t_ns, message, stands=lost)


def _failed(record: Record) -> TypeGuard[HealthEvent]:
    """Tell whether a method failed inside its block, which goes on by itself."""
    return isinstance(record, HealthEvent) and (record.source, record.cause) == (ESTIMATION, FAILURE)


def _estimates(record: Record) -> bool:
    if not isinstance(record, EstimateBatch):
        return False
    nothing = (record.status == Status.WARMING) | (record.reason == Reason.DIVERGED)
    return not bool(nothing.all())
