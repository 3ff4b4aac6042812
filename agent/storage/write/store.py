"""The single writer of the database: what `write` returned from is on the disk, whatever happens next."""

import sqlite3
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Self

from agent.errors import StoreError
from agent.records import Baseline, ClockRecord, CovariateMean, HealthEvent, Record, RunInfo
from agent.storage.database.columns import insert_rows
from agent.storage.database.compaction import BrokenOffError, compact, remove_left_over
from agent.storage.database.connect import (
    FRAME_BYTES,
    cause_of,
    code_of,
    connect_writer,
    create,
    is_damage,
    may_pass,
    transaction,
)
from agent.storage.database.files import (
    Ballast,
    Kind,
    Lock,
    beside,
    check_place,
    check_writable,
    kind_of,
    refuse,
    refuse_links,
    renew,
    sync_folder,
)
from agent.storage.database.schema import upgrade
from agent.storage.database.verify import Scrubber, problems_at_start
from agent.storage.recovery.salvage import Recovery, finish_interrupted, recover
from agent.storage.tables.alarms import AlarmRow, AlarmRows, standing_alarms
from agent.storage.tables.baselines import plan_of, standing_baselines
from agent.storage.tables.covariates import newest_means
from agent.storage.tables.notifications import Outbox, Route, nobody
from agent.storage.tables.records import newest_learnt
from agent.storage.tables.rows import Names, Numbers, Plan
from agent.storage.tables.run_rows import RunRows, run_plan
from agent.storage.tables.shelves import Shelf
from agent.storage.tuning import CELLS_A_CHECKPOINT, CHECKPOINT_EVERY, LAG_MEMORY_NS, SPILL_BYTES
from agent.storage.write.retention import Retention, TierKeeper
from agent.storage.write.spill import merge, open_spill
from agent.storage.write.watermark import Watermarks
from agent.types import AlarmTransition, Learnt

_FRAMES_BEFORE_SPILL = SPILL_BYTES // FRAME_BYTES
_FOR_EVER = Retention(float("inf"), float("inf"), float("inf"), float("inf"))


class Store:
    """One open database, owned by this process through its lock file; one thread at a time uses it.

    Made by `Store.open`. Writing raises sqlite3.Error (or OSError) when the disk refuses; nothing of that
    call is then acknowledged, and the same plans may be committed again after `reopen`.
    """

    def __init__(self, path: Path, lock: Lock, keep: Retention, route: Route = nobody) -> None:
        self.path = path
        self._lock = lock
        self._watermarks = Watermarks(lock.handle, private=lock.private)
        self._mutex = threading.RLock()
        self._connection: sqlite3.Connection | None = None
        self._side: sqlite3.Connection | None = None
        self._ballast = Ballast(path)
        self.numbers = Numbers()
        self.names = Names(self.numbers)
        self._tiers = TierKeeper(self, keep)
        self._run_rows = self._new_run_rows({})
        self._since_checkpoint = [0, 0]
        self._keep = keep
        self._scrubber = Scrubber()
        self._missing: str | None = None
        self._maintaining = False
        self.outbox = Outbox(route)
        """Adds to each step of an alarm whom to notify of it."""
        self.shelves: dict[int, Shelf | None] = {}
        """The shelves of alarms that were asked for, by alarm."""
        self.hurried = False
        """Whether the process is ending: nothing is purged any more, and of aggregates only the next made."""
        self.recovery: Recovery | None = None
        """What became of a damaged file that was found here; reported in the next run that begins."""

    @classmethod
    def open(cls, path: Path | str, keep: Retention = _FOR_EVER, route: Route = nobody) -> Self:
        """Open or create the database at a path and take its lock.

        keep: how long rows are kept and how large the file may grow; without it, for ever.
        route: names the targets that a step of an alarm is for.

        Raises:
            StoreError: a directory, no folder, no permission, not ours, newer, or another process writes to
                it.
            sqlite3.Error, OSError: the disk refuses; trying again later may help (see `connect.may_pass`).
        """
        path = Path(path)
        check_place(path)
        refuse_links(path)
        refuse(path, kind_of(path))
        check_writable(path)
        store = cls(path, Lock(path), keep, route)
        try:
            store._attach()
        except BaseException:
            store.close()
            raise
        return store

    def retain(self, keep: Retention) -> None:
        """Keep rows for other times, and in a file of another size, from now on."""
        self._keep = keep
        self._tiers.retain(keep)

    def _new_run_rows(self, settings: dict[str, list[ClockRecord]]) -> RunRows:
        return RunRows(self.names, self.numbers, lambda: self.connection, self._tiers.watch, settings)

    def _attach(self) -> None:
        """Open the file; on a full disk after dropping the ballast and the oldest hour of rows.

        A file that was opened in part is closed again: what it acknowledged might not outlive a power cut.
        """
        try:
            self._attach_file()
        except BaseException:
            self._disconnect()
            raise
        self._ballast.lay()

    def _attach_file(self) -> None:
        try:
            self._open_file()
        except (sqlite3.Error, OSError):
            if self._ballast.room() or not self._ballast.drop():
                raise
            self._disconnect()
            self._open_file()
            self._tiers.make_room()
            self.checkpoint("TRUNCATE")

    def _open_file(self) -> None:
        """Open the file, update it and learn what it names; a damaged one is replaced by what it tells."""
        remove_left_over(self.path)
        aside = finish_interrupted(self.path)
        if aside is not None:
            self.recovery = Recovery(aside, "its replacement had been interrupted", 0, 0)
        kind = kind_of(self.path)
        refuse(self.path, kind)
        if kind is Kind.MISSING:
            create(self.path)
            self._watermarks.forget()
        damage = "its header is damaged" if kind is Kind.DAMAGED else self._torn() or self._connect()
        if damage:
            self._replace(damage)
        self.numbers.leap(self._watermarks.highs)
        sync_folder(self.path.parent)  # SQLite does so for its log, but does not mind when it fails

    def _torn(self) -> str | None:
        """Return what was acknowledged and only a torn log holds; the next run tells what no log holds."""
        words, torn = self._watermarks.missing(self.path)
        self._missing = None if torn else words
        return words if torn else None

    def _connect(self) -> str | None:
        """Open the file; returns what is wrong with it, None when nothing was found."""
        try:
            renew(beside(self.path, "-wal"))
            self._connection = connect_writer(self.path)
            upgrade(self._connection)
            found = problems_at_start(self._connection)
            if found:
                return found[0]
            merge(self.path, self._connection)
            self.numbers.load(self._connection)
            self.names.load(self._connection)
            self._tiers.load()
        except sqlite3.Error as error:
            if is_damage(error) or (not may_pass(error) and isinstance(error, sqlite3.OperationalError)):
                return str(error)
            raise
        except UnicodeDecodeError:  # SQLite quotes the damaged schema in its message
            return "its schema is damaged"
        return None

    def _replace(self, damage: str) -> None:
        """Go on in a new file with the rows that could be saved; runs must be begun again.

        The recovery counts what is lost; what the damaged file itself seemed to lack is not reported beside
        it.
        """
        self._disconnect()
        self._missing = None
        self.recovery = recover(self.path, damage, self._watermarks.highs)
        self.names = Names(self.numbers)
        self._tiers = TierKeeper(self, self._keep)
        self._run_rows = self._new_run_rows(self._run_rows.settings())
        problem = self._connect()
        if problem is not None:
            raise StoreError.at(self.path, f"the database cannot be repaired ({problem})", "replace its disk")

    def recover(self, cause: str) -> None:
        """Replace the file because damage was met while it was open; runs must be begun again."""
        with self._mutex:
            self._replace(cause)

    @property
    def connection(self) -> sqlite3.Connection:
        """The writing connection; StoreError when the store is closed."""
        if self._connection is None:
            raise StoreError.at(self.path, "the database is closed", "open it again")
        return self._connection

    def begin_run(self, run: RunInfo) -> int:
        """Record a run and return its number; a live run goes on with the alarms that earlier ones left."""
        with self._mutex:
            run_id = self.numbers.take("runs")
            standing = [one.baseline_id for one in self.baselines(run.rig) if one.baseline_id is not None]
            run = replace(run, baseline_id=max(standing, default=run.baseline_id))
            self.commit([run_plan(run_id, run, self.names, self.numbers)])
            self.adopt_run(run_id, run)
            self._report_recovery(run_id, run)
            return run_id

    def _report_recovery(self, run_id: int, run: RunInfo) -> None:
        """Record that a damaged file was replaced: an event, and an alarm that is over but unacknowledged."""
        if self._missing is not None:
            self.write(run_id, [HealthEvent(run.rig, "store", run.started_ns, "rows missing", self._missing)])
            self._missing = None
        if self.recovery is None:
            return
        ends_ns = (run.started_ns, run.started_ns)
        self.write(run_id, outage(run.rig, ends_ns, ("damaged", "replaced"), str(self.recovery)))
        self.recovery = None

    def adopt_run(self, run_id: int, run: RunInfo) -> None:
        """Go on with a run that is in the file already."""
        standing = self.open_alarms(run.rig) if run.kind == "live" else []
        self._run_rows.open(run_id, run, AlarmRows(run_id, standing, self.outbox))

    def end_run(self, run_id: int) -> None:
        """Forget a run: nothing is written to it any more."""
        with self._mutex:
            self._run_rows.close(run_id)

    def open_alarms(self, rig: str, kind: str = "live") -> list[AlarmRow]:
        """Return the alarms of a rig that are not back to normal (NORM), over its runs of one kind."""
        with self._mutex:
            return standing_alarms(self.connection, rig, kind)

    @property
    def open_runs(self) -> RunRows:
        """The runs that are open for writing."""
        return self._run_rows

    def shelf(self, alarm_id: int, stored: Callable[[], Shelf | None]) -> Shelf | None:
        """Return the shelf of an alarm as it was made here, else as it is stored."""
        if alarm_id not in self.shelves:
            self.shelves[alarm_id] = stored()
        return self.shelves[alarm_id]

    def learnt(self, run: RunInfo) -> Learnt | None:
        """Return what earlier runs of this one's rig, kind and key learnt; None for nothing."""
        if run.learnt_key is None:
            return None
        with self._mutex:
            content = newest_learnt(self.connection, run.rig, run.kind, run.learnt_key)
        return None if content is None else Learnt(run.learnt_key, content)

    def baselines(self, rig: str) -> tuple[Baseline, ...]:
        """Return the baselines of a rig that stand, one a parameter."""
        with self._mutex:
            return standing_baselines(self.connection, rig)

    def covariates(self, rig: str) -> list[CovariateMean]:
        """Return the newest means of a rig's covariates, as far back as a machine may lag behind them."""
        with self._mutex:
            return newest_means(self.connection, rig, LAG_MEMORY_NS)

    def add_baselines(self, baselines: Sequence[Baseline]) -> list[Baseline]:
        """Store baselines, each in place of its parameter's; return them with their numbers, committed."""
        with self._mutex:
            plan, numbered = plan_of(baselines, self.names, self.numbers)
            self.commit([plan])
            return numbered

    def write(self, run_id: int, records: Sequence[Record]) -> None:
        """Store records of a run; on return they are committed and survive a power cut.

        All of them in one transaction, but that more than 20,000 estimates are cut into several.
        """
        with self._mutex:
            self.commit(self.encode(run_id, records))

    def encode(self, run_id: int, records: Sequence[Record]) -> list[Plan]:
        """Turn records into the rows of one or several transactions; nothing is written yet."""
        if run_id not in self._run_rows:
            raise StoreError.at(self.path, f"there is no run {run_id} open for writing", "begin a run first")
        return self._run_rows.plans(run_id, records)

    def commit(self, plans: Sequence[Plan]) -> None:
        """Write plans, a transaction each; on return they are on disk. Committing one again is harmless."""
        with self._mutex:
            for plan in plans:
                self._transaction(plan)
            self._checkpoint_if_due()

    def _transaction(self, plan: Plan) -> None:
        with self.transaction(self._side) as connection:
            for source in (self.names.fresh, plan):
                for table, rows in source.rows.items():
                    insert_rows(connection, table, rows)
        self.names.saved()
        self._watermarks.note(plan.rows)
        self._tiers.stored(plan)
        self._since_checkpoint[0] += 1
        self._since_checkpoint[1] += len(plan.rows.get("estimates", ()))

    @contextmanager
    def transaction(self, side: sqlite3.Connection | None = None) -> Iterator[sqlite3.Connection]:
        """Run what stands inside as one transaction; side: on another connection than the file's own."""
        with self._mutex:
            connection = side or self.connection
            with transaction(connection):
                yield connection

    def _checkpoint_if_due(self) -> None:
        commits, cells = self._since_checkpoint
        if commits >= CHECKPOINT_EVERY or cells >= CELLS_A_CHECKPOINT:
            frames, moved = self.checkpoint()
            if self._side is None and moved < frames > _FRAMES_BEFORE_SPILL:
                self._side = open_spill(self.path)
            elif self._side is not None and moved == frames:
                self._unspill()

    def checkpoint(self, mode: str = "PASSIVE") -> tuple[int, int]:
        """Move the write-ahead log into the file; returns the frames it holds and those of them moved."""
        self._since_checkpoint = [0, 0]
        if self._side is not None:
            self._side.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
        _, frames, moved = self.connection.execute(f"PRAGMA wal_checkpoint({mode})").fetchone()
        return frames, moved

    @property
    def spilling(self) -> bool:
        """Tell whether rows go to the side file, because a reader has not ended for too long."""
        return self._side is not None

    def _unspill(self) -> None:
        """Take the rows of the side file in, now that the log can be emptied."""
        if self._side is not None:
            self._side.close()
            self._side = None
        merge(self.path, self.connection)

    def count(self, name: str, more: int) -> None:
        """Add to a counter that the file keeps (rows purged before they were sent ...)."""
        with self._mutex:
            known = self.connection.execute(
                "SELECT seq, count FROM counters WHERE name = ?", (name,)
            ).fetchone()
            seq, total = known or (self.numbers.take("counters"), 0)
            plan = Plan()
            plan.sealed("counters", seq, name, total + more)
            self.commit([plan])

    def reopen(self) -> None:
        """Close the connection and open the file anew, keeping the lock; for after a failed write."""
        with self._mutex:
            self._disconnect()
            self._attach()

    def revive(self, error: BaseException, *, pressed: bool = False) -> None:
        """Do what can be done after a failed write, then open the file anew.

        A full disk is waited for. Only when `pressed` (what waits in memory would soon be lost) the ballast
        is dropped, which gives the room to delete the oldest hour of rows, whose place the new ones then
        take.
        """
        with self._mutex:
            if cause_of(error) != "disk full":
                self.reopen()
            elif pressed:
                self._ballast.drop()
                self.reopen()
                self._tiers.make_room()
                self.checkpoint("TRUNCATE")

    def compact(self) -> dict[str, int]:
        """Give free pages back to the disk; returns the file's bytes, its log taken in, before and after.

        Needs room for a copy, and no other transaction meanwhile.
        """
        with self._mutex:
            self.checkpoint("TRUNCATE")
            before = self.path.stat().st_size
            if not self._finished(lambda: compact(self.connection, self.path, lambda: self.hurried)):
                raise StoreError.at(self.path, "its agent is ending", "ask again when it has ended")
            self.checkpoint("TRUNCATE")
            return {"bytes_before": before, "bytes_after": self.path.stat().st_size}

    def maintain(self, *, finish: bool = False) -> None:
        """Make the minutes and hours due and purge what is too old or too much; cheap when nothing is due."""
        with self._mutex:
            if self.spilling:
                self._checkpoint_if_due()
            elif not self.hurried or finish:
                self._finished(lambda: self._tiers.step(finish=finish))
                self._scrubber.step(self.connection)
                self._ballast.lay()

    def hurry(self) -> None:
        """Break off what no row waits for, such as a purge, and begin none any more; from any thread."""
        self.hurried = True
        connection = self._connection
        if self._maintaining and connection is not None:
            connection.interrupt()

    def _finished(self, act: Callable[[], object]) -> bool:
        """Do what `hurry` may break off; tell whether it came to its end."""
        self._maintaining = True
        try:
            act()
        except BrokenOffError:
            return False
        except sqlite3.OperationalError as error:
            if not self.hurried or code_of(error) != sqlite3.SQLITE_INTERRUPT:
                raise
            return False
        finally:
            self._maintaining = False
        return True

    def _disconnect(self) -> None:
        connections, self._connection, self._side = (self._side, self._connection), None, None
        for connection in connections:
            if connection is not None:
                connection.close()

    def close(self) -> None:
        """Close the file (which empties the write-ahead log) and give the lock back; harmless when closed."""
        with self._mutex:
            try:
                self._disconnect()
            finally:
                self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def outage(rig: str, ends_ns: tuple[int, int], causes: tuple[str, str], message: str) -> list[Record]:
    """Return the records of an outage of the store that is over: an event, an alarm raised and returned.

    Args:
        rig: whose rows it concerned.
        ends_ns: when it began and when it ended, ns.
        causes: of the alarm, and of its return to normal, which is not acknowledged.
        message: for people.
    """
    (began_ns, ended_ns), (cause, end) = ends_ns, causes
    raised = AlarmTransition(rig, "source", "store", "high", began_ns, "NORM", "UNACK", cause, message)
    returned = replace(raised, t_ns=ended_ns, from_state="UNACK", to_state="RTNUN", cause=end)
    return [HealthEvent(rig, "store", ended_ns, cause, message), raised, returned]
