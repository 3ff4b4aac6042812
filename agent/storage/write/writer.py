"""The thread between pipeline and store: takes records, never blocks and keeps at it when disks fail."""

import logging
import sqlite3
import threading
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from agent.clock import wall_ns
from agent.errors import StoreError
from agent.records import Baseline, ClockRecord, CovariateMean, HealthEvent, Record, RunInfo
from agent.storage.database.connect import cause_of, is_damage
from agent.storage.tables.alarms import AlarmRow
from agent.storage.tables.rows import Plan
from agent.storage.tables.shelves import moment
from agent.storage.write.alarm_commands import expire_shelves
from agent.storage.write.backlog import Backlog, Histogram, Pause, cells_of
from agent.storage.write.command_socket import CommandServer, Handler
from agent.storage.write.commands import Listeners, serve
from agent.storage.write.decimation import Thinner
from agent.storage.write.jobs import Job, JobQueue
from agent.storage.write.retention import Density
from agent.storage.write.store import Store, outage
from agent.types import AlarmTransition, EstimateBatch, Learnt

_DISK = (sqlite3.Error, OSError)
_FAILURE = (*_DISK, StoreError)
_FULL = "queue full"

log = logging.getLogger(__name__)


class StoreWriter:
    """Writes the records of one or several rigs, a batch a second and alarm transitions at once.

    A disk that fails costs no sample: rows wait in memory (bounded; what falls out is counted in `dropped`),
    the file is opened again with growing pauses, and an event says so once it is over.

    Args:
        opener: opens the store; called again when it could not be opened or was lost.
        runs: one for each rig whose records will come.
        every_s: the thinning of CONTRACT's [store] table; 0 keeps all.
        lossless: for replays: `publish` waits for the disk instead of dropping, and a failing disk is an
            error.
        most_cells: rows that wait in memory at most, a rig.
        served: others may ask for what changes the file, through the socket beside it, and for these; None:
            no socket.
    """

    def __init__(
        self,
        opener: Callable[[], Store],
        runs: Sequence[RunInfo],
        *,
        every_s: float = 0.0,
        lossless: bool = False,
        most_cells: int = 200_000,
        period_s: float = 1.0,
        served: Mapping[str, Handler] | None = None,
    ) -> None:
        self._opener, self._every_s = opener, every_s
        self._runs: dict[str, RunInfo] = {}
        self._thinners: dict[str, Thinner] = {}
        self._backlogs: dict[str, Backlog] = {}
        self._newest: dict[str, int] = {}
        self._lossless, self._most, self._period = lossless, most_cells, period_s
        self._store: Store | None = None
        self._flight: dict[str, list[Record]] = {}
        self._plans: list[Plan] = []
        self._condition = threading.Condition()
        self._queue: list[Sequence[Record]] = []
        self._queued = 0
        self._urgent = self._stopping = self._ended = False
        self._asked = self._answered = 0
        self._pause = Pause()
        self._failure: BaseException | None = None
        self._failed_at: dict[str, int] = {}
        self._spilling = False
        self._served = served
        self._server: CommandServer | None = None
        self.on_alarm: Callable[[AlarmTransition], None] = lambda _: None
        """Called, in the writer's thread, with each alarm step by an operator or as a shelf ended."""
        self.on_outbox: Callable[[], None] = lambda: None
        """Called, in the writer's thread, when there may be something to notify targets of."""
        self.on_stored: Callable[[], None] = lambda: None
        """Called, in the writer's thread, when records were committed."""
        self._jobs = JobQueue(self._wake)
        self._thread = threading.Thread(target=self._work, name="store-writer", daemon=True)
        self.run_ids: dict[str, int] = {}
        self.standing: dict[str, list[AlarmRow]] = {}
        """The alarms that earlier live runs left standing, by rig, as they were when this one began."""
        self.learnt: dict[str, Learnt | None] = {}
        """What earlier runs learnt of each rig for the same key, as it was when this one began."""
        self.baselines: dict[str, tuple[Baseline, ...]] = {}
        self.covariates: dict[str, list[CovariateMean]] = {}
        """What each rig's parameters are counted from, as the file says now; a new tuple if that changed."""
        self.progress = 0
        """Grows with every round of the thread; a watchdog may read it."""
        self.written = 0
        """Rows of estimates, alarms and health that were acknowledged."""
        self.broken: str | None = None
        """What ended the thread where no disk did, in words; nothing is stored after it."""
        self.dropped_at_queue: Counter[str] = Counter()
        self.occupied = False
        """Whether it does what takes as long as it takes: a command, or saving a damaged file."""
        self.latency: dict[str, Histogram] = {}
        """From the newest sample of each commit to the disk, by rig."""
        self._admit(runs)

    # --- the pipeline's side --------------------------------------------------------------------------------

    def start(self) -> None:
        """Open the store and begin the runs; StoreError if it can never work, else failures are retried."""
        try:
            self._attach()
        except _DISK as error:
            self._failed(error)
            if self._lossless:
                raise StoreError.at("store", f"cannot be written ({error})", "look at its disk") from error
        self._thread.start()

    def publish(self, records: Sequence[Record]) -> None:
        """Hand over a pipeline step's records; never blocks (but for lossless) or raises for the disk."""
        cells = sum(map(cells_of, records))
        with self._condition:
            if self._lossless:
                self._condition.wait_for(lambda: self._queued < self._most or self._ended)
                self._raise_failure()
            elif self._queued + cells > self._most:
                records = self._only_alarms(records)
            self._queue.append(records)
            self._queued += cells
            if any(isinstance(r, AlarmTransition) for r in records) or self._queued > self._most // 8:
                self._urgent = True
                self._condition.notify_all()

    def exchange(self, leaving: Collection[str], entering: Sequence[RunInfo], density: Density) -> None:
        """End the runs of some rigs, all their records published, and begin others, in the writer's thread.

        The density holds from now on; a rig that leaves may have no run. Raises StoreError where the store
        cannot be written at present; nothing is changed then.
        """

        def act(store: Store) -> None:
            store.retain(density.keep)
            self._exchange(leaving, entering, density.every_s)
            self._period = density.commit_s

        self._jobs.ask(act)

    def ask(self, job: Job) -> Any:
        """Have something done with the store in the writer's thread; return its result. Raises StoreError."""
        return self._jobs.ask(job)

    def flush(self, timeout_s: float = 30.0) -> bool:
        """Wait until everything published so far is committed; False when that did not happen in time."""
        with self._condition:
            self._asked += 1
            ticket = self._asked
            self._condition.notify_all()
            done = self._condition.wait_for(lambda: self._answered >= ticket or self._ended, timeout_s)
            if self._lossless:
                self._raise_failure()
            return done and self._answered >= ticket

    def hurry(self) -> None:
        """See that nothing holds up the writing of rows any more; for a process that is about to end."""
        store = self._store
        if store is not None:
            store.hurry()

    def stop(self, timeout_s: float = 10.0) -> None:
        """Write what is left, close the store and end the thread; what a failing disk refuses is dropped.

        A thread that takes longer is left to itself, and rows that it had not written yet are lost with the
        process.
        """
        with self._condition:
            self._stopping = True
            self._condition.notify_all()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
            if self.is_alive():
                words = (
                    "%s: is busy for longer than the end may take; rows since its last commit are not stored"
                )
                log.warning(words, self._place())
        else:
            self._end()
        if self._lossless:
            self._raise_failure()

    def is_alive(self) -> bool:
        """Tell whether the thread runs."""
        return self._thread.is_alive()

    @property
    def dropped(self) -> Counter[str]:
        """Rows that could not be stored, by reason."""
        return sum((b.dropped for b in self._backlogs.values()), Counter(self.dropped_at_queue))

    @property
    def failing(self) -> str | None:
        """Why the store cannot be written at present; None when it can."""
        return self._pause.cause

    def _admit(self, runs: Sequence[RunInfo]) -> None:
        for run in runs:
            self._runs[run.rig] = run
            self._thinners[run.rig] = Thinner(self._every_s)
            self._backlogs[run.rig] = Backlog(self._most)
            self._newest[run.rig] = self._failed_at[run.rig] = run.started_ns
            self.latency.setdefault(run.rig, Histogram())

    def _only_alarms(self, records: Sequence[Record]) -> list[Record]:
        kept: list[Record] = [r for r in records if isinstance(r, AlarmTransition | ClockRecord)]
        self.dropped_at_queue[_FULL] += sum(map(cells_of, records)) - len(kept)
        return kept

    def _wake(self) -> None:
        with self._condition:
            self._urgent = True
            self._condition.notify_all()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            why = self.broken or str(self._failure)
            advice = "look at its disk" if self.broken is None else "see the log"
            raise StoreError.at("store", f"cannot be written ({why})", advice) from self._failure

    def _place(self) -> str:
        return "the store" if self._store is None else str(self._store.path)

    # --- the thread's side ----------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            while not self._round():
                pass
        except Exception as error:
            # from here on nothing is stored: whoever publishes or watches must hear of it
            log.exception("%s: the thread that writes to it failed", self._place())
            self.broken = f"{type(error).__name__}: {error}"
            self._failure = error
        finally:
            self._end()

    def _round(self) -> bool:
        """Wait, take what came, write it; True when the thread has nothing left to do."""
        ticket, last = self._wait()
        self.progress += 1
        self._collect(last)
        self._write_all(last)
        self._run_jobs()
        with self._condition:
            if not self._waiting() or last:
                self._answered = ticket
            self._condition.notify_all()
        return last or (self._lossless and self._failure is not None)

    def _wait(self) -> tuple[int, bool]:
        with self._condition:
            self._condition.wait_for(
                lambda: (
                    self._urgent or self._stopping or (self._asked > self._answered and not self._pause.cause)
                ),
                min(self._period, self._pause.length_s) if self._pause.cause else self._period,
            )
            self._urgent = False
            return self._asked, self._stopping

    def _exchange(self, leaving: Collection[str], entering: Sequence[RunInfo], every_s: float) -> None:
        self._collect(last=False)
        known = [rig for rig in leaving if rig in self._runs]
        for rig in list(self._thinners) if every_s != self._every_s else known:
            self._keep(rig, self._thinners[rig].flush())
            self._thinners[rig] = Thinner(every_s)
        self._every_s = every_s
        self._write_all(last=False)
        tables = (self._runs, self._thinners, self._backlogs, self._newest, self._failed_at, self.run_ids,
                  self.standing, self.learnt, self.baselines, self.covariates)  # fmt: skip
        for rig in leaving:
            if self._store is not None and rig in self.run_ids and not self._waiting():
                self._store.end_run(self.run_ids[rig])
            for table in tables:
                table.pop(rig, None)
        self._admit(entering)
        self._attach()

    def _collect(self, last: bool) -> None:
        """Thin what came and put it into the backlog of its rig."""
        with self._condition:
            queue, self._queue, self._queued = self._queue, [], 0
            self._condition.notify_all()
        for records in queue:
            for rig in {r.rig: None for r in records if r.rig in self._runs}:
                self._keep(rig, self._thinners[rig].feed([r for r in records if r.rig == rig]))
        if last:
            for rig, thinner in self._thinners.items():
                self._keep(rig, thinner.flush())

    def _keep(self, rig: str, records: Sequence[Record]) -> None:
        for record in records:
            t_ns = int(record.t_ns[-1]) if isinstance(record, EstimateBatch) else record.t_ns
            self._newest[rig] = t_ns if isinstance(record, ClockRecord) else max(self._newest[rig], t_ns)
        self._backlogs[rig].add(records, self._pause.cause or _FULL)

    def _waiting(self) -> bool:
        return bool(self._flight) or any(map(len, self._backlogs.values()))

    def _write_all(self, last: bool) -> None:
        """Write what waits, if it is not too soon after a failure."""
        if self._pause.cause and not last and not self._pause.over():
            return
        try:
            self._attach()
            while self._waiting():
                self._write_once()
            if self._store is not None:
                for ended in expire_shelves(self._store, moment()):
                    self._notify(ended.step)
                self._store.maintain(finish=last)
                self._report_spilling(self._store.spilling)
        except _FAILURE as error:
            self._failed(error)
        else:
            if self._pause.cause is not None:
                self._recovered()
                self._write_all(last)

    def _write_once(self) -> None:
        """Commit what is in flight; what failed before is committed again as is, storing nothing twice."""
        store = self._store
        assert store is not None  # noqa: S101 - _attach made it
        if not self._flight:
            self._flight = {rig: records for rig, b in self._backlogs.items() if (records := b.take())}
        if not self._plans:
            self._plans = [
                p for rig, records in self._flight.items() for p in store.encode(self.run_ids[rig], records)
            ]
        store.commit(self._plans)
        self._note_latency()
        if any("notifications" in plan.rows for plan in self._plans):
            self.on_outbox()
        for rig, records in self._flight.items():
            self.written += sum(map(cells_of, records))
            self._report_stored(rig, records)
        self._flight, self._plans = {}, []
        self.on_stored()

    def _note_latency(self) -> None:
        now = wall_ns()
        for rig, records in self._flight.items():
            newest = self._newest_stored(records)
            if newest:
                self.latency[rig].observe(max(0.0, (now - newest) / 1e9))

    def _report_stored(self, rig: str, records: Sequence[Record]) -> None:
        """Log what is on the disk from now on, whatever happens next."""
        if log.isEnabledFor(logging.INFO):
            hops = sum(len(r) for r in records if isinstance(r, EstimateBatch))
            steps = sum(isinstance(r, AlarmTransition) for r in records)
            words = "%s: stored in run %d: %d instants up to %d, %d steps of alarms, %d others"
            others = sum(not isinstance(r, EstimateBatch | AlarmTransition) for r in records)
            log.info(words, rig, self.run_ids[rig], hops, self._newest_stored(records), steps, others)

    @staticmethod
    def _newest_stored(records: Sequence[Record]) -> int:
        return max((int(r.t_ns[-1]) for r in records if isinstance(r, EstimateBatch)), default=0)

    def _run_jobs(self) -> None:
        if self._store is None or self._pause.cause:
            self._jobs.refuse(f"cannot write to it at present ({self._pause.cause})", "look at its disk")
        elif self._jobs:
            self.occupied = True
            self._jobs.run(self._store)
            self.occupied = False

    def _attach(self) -> None:
        """See that the store is open, its socket is there and the runs are begun."""
        if self._store is None:
            self._store = self._opener()
        if self._store.recovery is not None:  # a new file
            self.run_ids.clear()
            self._plans = []
        if self._served is not None and self._server is None:
            self._server = self._serve(self._store, self._served)
        for rig, run in self._runs.items():
            if rig not in self.run_ids:
                self.learnt.setdefault(rig, self._store.learnt(run))
                self.standing[rig] = self._store.open_alarms(rig) if run.kind == "live" else []
                self.baselines[rig] = self._store.baselines(rig)
                self.covariates[rig] = self._store.covariates(rig)
                self.run_ids[rig] = self._store.begin_run(run)

    def _serve(self, store: Store, handlers: Mapping[str, Handler]) -> CommandServer | None:
        try:
            listeners = Listeners(self._notify, self._take_baselines, self._announce)
            return serve(store.path, self._jobs, listeners, handlers)
        except OSError as error:
            log.warning("%s: no socket for commands can be made beside it: %s", store.path, error)
            return None

    def _notify(self, step: AlarmTransition) -> None:
        self.on_alarm(step)
        self._announce()

    def _announce(self) -> None:
        self.on_outbox()

    def _take_baselines(self, store: Store) -> None:
        """Note that baselines were stored."""
        self.baselines = {rig: store.baselines(rig) for rig in self._runs}

    def _failed(self, error: BaseException) -> None:
        """Note a failure and try to be able to go on next time."""
        if self._pause.cause is None:
            self._failed_at = dict(self._newest)
            log.warning(
                "%s: cannot be written (%s: %s); rows wait in memory", self._place(), cause_of(error), error
            )
        self._pause.failed(cause_of(error))
        self._failure = error
        if self._store is None:
            return
        try:
            if is_damage(error):
                self._replace_file(str(error))
            else:
                self._store.revive(error, pressed=self._pressed())
        except _FAILURE as second:
            self._pause.failed(cause_of(second))

    def _pressed(self) -> bool:
        """Tell whether what waits would soon not fit in memory any more."""
        waiting = sum(cells_of(r) for records in self._flight.values() for r in records)
        return max((len(b) for b in self._backlogs.values()), default=0) + waiting > self._most // 2

    def _replace_file(self, cause: str) -> None:
        """Go on in a new file with what could be read of the damaged one; rows in flight are stored anew."""
        assert self._store is not None  # noqa: S101 - checked by the caller
        self.occupied = True
        try:
            self._store.recover(cause)
        finally:
            self.occupied = False

    def _report_spilling(self, spilling: bool) -> None:
        """Say once when rows begin to go to the side file, and once when they are taken in again."""
        if spilling == self._spilling:
            return
        self._spilling = spilling
        began = (
            "a reader of the database does not end: "
            "new rows go to a side file and are not shown until it does"
        )
        cause, message = (
            ("reader", began) if spilling else ("reader ended", "the rows of the side file were taken in")
        )
        for rig in self._runs:
            event = HealthEvent(rig, "store", self._newest[rig], cause, message)
            self._backlogs[rig].add([event], _FULL)

    def _recovered(self) -> None:
        """After a failure: say how long it lasted and what it cost, once, by an event and an ended alarm."""
        cause, since = self._pause.passed()
        self._failure = None
        for rig in self._runs:
            lost = sum(self._backlogs[rig].dropped.values())
            message = (
                f"the store could not be written for {since:.1f} s ({cause}); "
                f"{lost} rows did not fit in memory"
            )
            ends_ns = (self._failed_at[rig], self._newest[rig])
            self._backlogs[rig].add(outage(rig, ends_ns, (cause, "recovered"), message), cause)
        log.warning("%s: can be written again after %.1f s", self._place(), since)

    def _end(self) -> None:
        self._jobs.end()
        try:
            if self._server is not None:
                self._server.stop()
        except OSError as error:  # on a disk that became read-only; the next start replaces the socket
            log.warning("%s: the socket for commands beside it stays: %s", self._place(), error)
        for rig, backlog in self._backlogs.items():
            left = sum(map(cells_of, [*self._flight.pop(rig, ()), *backlog.take()]))
            if left:
                backlog.dropped[self._pause.cause or "stopped"] += left
                log.warning("%s: %d rows could not be stored before the end", self._place(), left)
        with self._condition:
            self._ended = True
            self._condition.notify_all()
        if self._store is not None:
            self._store.close()
