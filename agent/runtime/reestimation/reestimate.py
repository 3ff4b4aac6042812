"""`deltak reestimate`: archives of many rigs estimated again, as many at once as there are processes."""

import logging
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.clock import wall_ns
from agent.errors import AgentError, Fault, RecordingError, UsageError
from agent.runtime.reestimation.archive import Recorded, configured, gathered
from agent.runtime.reestimation.keeping import Databases, Merge
from agent.runtime.reestimation.parts import First, Part, computed
from agent.runtime.reestimation.pools import Pool, pool_of
from agent.runtime.tuning import MOST_TRIES
from agent.units import HOUR_NS

Progress = Callable[[str], None]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What is asked for.

    Attributes:
        archives: recordings, or folders of them.
        configs: configurations, or folders of them.
        db: see `Databases`; None keeps nothing.
        scheduler: "local", or the address of a Dask scheduler.
        workers: local processes; None for one a core.
        hour_ns: where rigs are parted.
    """

    archives: Sequence[Path]
    configs: Sequence[Path]
    db: str | None = None
    scheduler: str = "local"
    workers: int | None = None
    hour_ns: int = HOUR_NS


@dataclass(slots=True)
class Work:
    """A part that is computed: whose it is, what it goes on from, and how many processes died over it."""

    merge: Merge
    given: First | bytes
    tries: int = 0


@dataclass(slots=True)
class Reestimation:
    """Rigs that are computed part after part, several rigs at once.

    Attributes:
        pool: what computes parts.
        wanted: what is asked for.
        waiting: rigs that are not begun.
        faults: what could not be used, in words, a file or rig each.
        parts, repeated: how many were computed, and how many of them again because their process died.
    """

    pool: Pool
    wanted: Wanted
    databases: Databases
    waiting: deque[Recorded]
    faults: list[Fault]
    progress: Progress
    merges: list[Merge] = field(default_factory=list)
    parts: int = 0
    repeated: int = 0
    ended: int = 0
    _pending: dict[Future[Part], Work] = field(default_factory=dict)
    _begun_s: float = field(default_factory=time.monotonic)

    def run(self) -> None:
        """Compute all. Raises StoreError."""
        while self._pending or self.waiting:
            # one more than there are processes: none waits while this one writes
            while self.waiting and len(self._pending) <= self.pool.size:
                self._begin(self.waiting.popleft())
            done, _ = wait(self._pending, return_when=FIRST_COMPLETED)
            self._take([(self._pending.pop(future), future) for future in done])
            self.progress(self._words())
        self.progress("")

    def _begin(self, recorded: Recorded) -> None:
        merge = Merge(recorded.rig, self.databases)
        self.merges.append(merge)
        self._submit(Work(merge, First(recorded, merge.known)))

    def _submit(self, work: Work) -> None:
        try:
            future = self.pool.submit(computed, work.given, self.wanted.hour_ns)
        except BrokenProcessPool as error:  # a process died just now: seen with the others that it broke
            future = Future()
            future.set_exception(error)
        self._pending[future] = work

    def _take(self, done: Sequence[tuple[Work, Future[Part]]]) -> None:
        broken: list[Work] = []
        for work, future in done:
            try:
                part = future.result()
            except BrokenProcessPool:
                broken.append(work)
            except CancelledError as error:
                advice = "start it and this command again"
                raise UsageError.at("--scheduler", f"{self.wanted.scheduler} is gone", advice) from error
            except self.pool.given_up as error:
                self._fail(work.merge, [_fatal(work.merge, str(error))])
            except AgentError as error:
                self._fail(work.merge, error.faults)
            else:
                self._go_on(work.merge, part)
        if broken:
            self._repeat(broken)

    def _go_on(self, merge: Merge, part: Part) -> None:
        """Have the next part computed while this one is stored."""
        self.parts += 1
        self.faults += part.damaged
        if part.rest is not None:
            self._submit(Work(merge, part.rest))
        merge.take(part)
        self.ended += part.rest is None

    def _repeat(self, broken: list[Work]) -> None:
        """Compute again what was under way when a local process died."""
        wait(self._pending)
        broken += [
            self._pending.pop(future)
            for future in list(self._pending)
            if isinstance(future.exception(), BrokenProcessPool)
        ]
        log.warning("a process died; %d parts are computed again", len(broken))
        self.pool.renew()
        for work in broken:
            work.tries += 1
            self.repeated += 1
            if work.tries < MOST_TRIES:
                self._submit(work)
            else:
                self._fail(work.merge, [_fatal(work.merge, f"{MOST_TRIES} times")])

    def _fail(self, merge: Merge, faults: Sequence[Fault]) -> None:
        self.faults += faults
        self.ended += 1
        merge.end()

    def _words(self) -> str:
        samples = sum(merge.summary.samples()["received"] for merge in self.merges)
        seconds = max(time.monotonic() - self._begun_s, 1e-3)
        rigs = len(self.merges) + len(self.waiting)
        return (
            f"{self.ended} of {rigs} rigs, {self.parts} hours, {samples:,} samples, "
            f"{samples / seconds:,.0f} a second"
        )

    def document(self) -> dict[str, Any]:
        """Return what was found: replays' documents by rig, and what could not be used."""
        seconds = time.monotonic() - self._begun_s
        runs = [merge.document() for merge in self.merges if merge.summary.windows]
        received = sum(run["samples"]["received"] for run in runs)
        return {
            "runs": runs, "scheduler": self.wanted.scheduler, "workers": self.pool.size, "parts": self.parts,
            "repeated": self.repeated, "made_at_ns": wall_ns(), "seconds": seconds,
            "samples_per_s": received / seconds if seconds > 0 else None, "errors": self.faults,
        }  # fmt: skip


def _fatal(merge: Merge, words: str) -> Fault:
    what = f"is left there: the processes that computed its next hour died ({words})"
    return Fault(merge.rig.rig.name, what, "see the kernel's log whether memory ran out")


def reestimate(wanted: Wanted, progress: Progress) -> dict[str, Any]:
    """Estimate archives again and return what was found; files that cannot be used are in its errors.

    Raises ConfigError, UsageError, StoreError; RecordingError where nothing can be used.
    """
    archive = gathered(wanted.archives, configured(wanted.configs))
    if not archive.rigs:
        raise RecordingError(
            archive.faults or [Fault("ARCHIVE", "holds no recording", "name another folder")]
        )
    with closing(pool_of(wanted.scheduler, wanted.workers)) as pool:
        with closing(Databases(wanted.db, [found.rig for found in archive.rigs])) as databases:
            work = Reestimation(pool, wanted, databases, deque(archive.rigs), list(archive.faults), progress)
            work.run()
        return work.document()
