"""Writes event records in a thread of its own, keeps them within bounds and reports what became of each."""

import logging
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

from agent.clock import wall_ns
from agent.config.sections.results import Events
from agent.recording.ages import Ages
from agent.recording.event_files import (
    META,
    EventFolder,
    Labels,
    Taken,
    alone,
    npz_bytes,
    raw_bytes,
    read_meta,
    state_name,
    table_of,
)
from agent.recording.folder import AGES, make_folder, room
from agent.recording.header import RawHeader
from agent.recording.states import Rounds, State, state_bytes
from agent.recording.tuning import MOST_JOBS
from agent.records import EventRecord, HealthEvent, Record

SUFFIX = ".events"
ENDED = "the agent ended before all of it had come"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Facts:
    """What is the same in all records of a rig: its name, its sources' channels, fields, and provenance."""

    rig: str
    channels: dict[str, tuple[str, ...]]
    fields: dict[str, tuple[str, ...]]
    config_sha256: str
    code_version: str


@dataclass(frozen=True, slots=True)
class Job:
    """One writing of a record: what is known of it, and everything that belongs into it so far.

    span: the numbers of the first and the last sample that are wanted.
    state: what the rig knew before; last_round: in which the last alarm so far was raised.
    """

    record: EventRecord
    items: Sequence[Taken]
    labels: Sequence[Labels]
    span: tuple[int, int]
    moduli: dict[str, int | None]
    state: State | None = None
    last_round: int = 0


class EventWriter:
    """The event records of one rig on the disk.

    Args:
        db: the database; files go to the folder "DB.events" beside it.
        facts: see Facts.
        limits: the [store] table's `events`.
        publish: takes the rows of the index and what went wrong.
        known: the rows that the index has of this rig, asked for once, in the thread.
    """

    def __init__(
        self,
        db: Path,
        facts: Facts,
        limits: Events,
        publish: Callable[[Sequence[Record]], None],
        known: Callable[[], Sequence[EventRecord]] = lambda: (),
    ) -> None:
        self._facts, self._limits, self._publish, self._known = facts, limits, publish, known
        self._folder = EventFolder(db.with_name(db.name + SUFFIX), facts.rig)
        self._ages = Ages(self._folder.folder / f"{facts.rig}{AGES}")
        self._rows: dict[str, EventRecord] = {}
        self._jobs: deque[Job] = deque()
        self._condition = threading.Condition()
        self._stopping = False
        self._failing = False
        self._number = max(self._folder.groups(), default=-1) + 1
        self._thread = threading.Thread(target=self._work, name=f"events-{facts.rig}", daemon=True)
        self.progress = 0
        self.lost = 0
        """Records, or what came after the alarm of a record, that could not be written."""

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout_s: float = 20.0) -> None:
        """Write what waits and end the thread."""
        with self._condition:
            self._stopping = True
            self._condition.notify()
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def is_alive(self) -> bool:
        """Tell whether the thread runs."""
        return self._thread.is_alive()

    def name(self, kind: str, parameter: str) -> str:
        """Return the path of a new record, from the database's folder; of several sources with * for each."""
        number, self._number = self._number, self._number + 1
        ending = ".npz" if len(self._facts.channels) == 1 else ".*.raw"
        return f"{self._folder.folder.name}/{self._facts.rig}-{number:08d}-{kind}-{parameter}{ending}"

    def submit(self, job: Job) -> None:
        """Hand over a record; never blocks. Where too many wait it is lost, counted and reported."""
        with self._condition:
            if len(self._jobs) < MOST_JOBS:
                self._jobs.append(job)
                self._condition.notify()
                return
        self._lost(job, "the disk is too slow")

    def _work(self) -> None:
        self._take_stock()
        over = False
        while not over:
            with self._condition:
                self._await_jobs()
                jobs = list(self._jobs)
                over = self._stopping
                self._jobs.clear()
            for job in jobs:
                self.progress += 1
                self._write(job)
            self._prune()

    def _await_jobs(self) -> None:
        """Wait for a job, for a minute at most; who watches sees each second that the thread lives."""
        for _ in range(60):
            self.progress += 1
            if self._condition.wait_for(lambda: self._jobs or self._stopping, 1.0):
                return

    def _write(self, job: Job) -> None:
        try:
            self._make_room()
            record = self._written(job)
        except OSError as error:
            self._lost(job, error.strerror or str(error))
            return
        except Exception as error:
            # a fault here costs this record, is seen by all, and no other
            log.exception("%s: an event record could not be made", self._facts.rig)
            self._lost(job, f"{type(error).__name__}: {error}")
            return
        self._rows[record.file] = record
        if isfinite(self._limits.keep):
            self._ages.note(Path(record.file).name.replace("*", min(self._facts.fields)))
        events: list[Record] = [record]
        if self._failing:
            self._failing = False
            events.append(
                self._event("event records resumed", f"event records are kept again; {self.lost} were lost")
            )
        self._publish(events)

    def _written(self, job: Job) -> EventRecord:
        """Write a record's files; return its row."""
        if len(self._facts.channels) > 1:
            return self._written_raw(job)
        table = table_of(job.items, job.labels, job.span)
        (channels,) = self._facts.channels.values()
        span = (
            (int(table.t_ns[0]), int(table.t_ns[-1]))
            if len(table.t_ns)
            else (job.record.t_ns, job.record.t_ns)
        )
        record = replace(job.record, from_ns=span[0], to_ns=span[1], samples=len(table.t_ns))
        content = npz_bytes(table, channels, self._meta(record), _state(job))
        self._folder.write(Path(record.file).name, content)
        return replace(record, bytes=len(content))

    def _written_raw(self, job: Job) -> EventRecord:
        total = samples = 0
        for source, fields in self._facts.fields.items():
            items = [item for item in job.items if item.source == source]
            own = RawHeader(
                source, fields, job.moduli.get(source), self._facts.config_sha256, self._facts.code_version,
                wall_ns(), rig=self._facts.rig,
            )  # fmt: skip
            content = raw_bytes(own, items)
            self._folder.write(Path(job.record.file).name.replace("*", source), content)
            total, samples = total + len(content), samples + sum(len(item.block) for item in items)
        state = alone(_state(job, whole=True)) if job.state is not None else b""
        if state:
            self._folder.write(state_name(Path(job.record.file).name), state)
        total += len(state)
        stamps = [label.t_ns for label in job.labels]
        first, last = (
            (int(stamps[0][0]), int(stamps[-1][-1])) if stamps else (job.record.t_ns, job.record.t_ns)
        )
        return replace(job.record, from_ns=first, to_ns=last, samples=samples, bytes=total)

    def _meta(self, record: EventRecord) -> dict[str, Any]:
        """Return the provenance that stands in the file; until it is complete, what is found there is cut."""
        found = record if record.state != "recording" else replace(record, state="cut")
        provenance = {"config_sha256": self._facts.config_sha256, "code_version": self._facts.code_version}
        return {name: getattr(found, name) for name in META} | provenance

    def _lost(self, job: Job, why: str) -> None:
        """Note a record that could not be written: what of it is there already stays, and is cut."""
        self.lost += 1
        before = self._rows.get(job.record.file)
        words = f"not all could be kept: {why}"
        state = replace(job.record, state="failed") if before is None else replace(before, state="cut")
        events: list[Record] = [replace(state, message=words)]
        if not self._failing:
            self._failing = True
            events.append(self._event("event records stopped", f"event records cannot be kept: {why}"))
        self._publish(events)

    def _event(self, cause: str, message: str) -> HealthEvent:
        log.warning("%s: %s", self._facts.rig, message)
        return HealthEvent(self._facts.rig, "events", wall_ns(), cause, message)

    # --- bounds ---------------------------------------------------------------------------------------------

    def _take_stock(self) -> None:
        """See what earlier runs left: half-written files go, cut records say so, lost rows are made anew."""
        try:
            self._folder.clean()
            self._rows = {row.file: row for row in self._known()}
            there = {path.name for paths in self._folder.groups().values() for path in paths}
        except OSError as error:
            log.warning("%s: event records cannot be looked through: %s", self._facts.rig, error)
            return
        rows = [changed for row in self._rows.values() if (changed := _after_restart(row, there)) is not None]
        rows += [row for name in sorted(there) if (row := self._unlisted(name)) is not None]
        self._rows |= {row.file: row for row in rows}
        if rows:
            self._publish(rows)

    def _unlisted(self, name: str) -> EventRecord | None:
        """Return the row of a file that the index does not know, as the power went before it was written."""
        file = f"{self._folder.folder.name}/{name}"
        path = self._folder.folder / name
        if file in self._rows or path.suffix != ".npz" or not (meta := read_meta(path)):
            return None
        row = EventRecord(**{name: meta[name] for name in META}, file=file, bytes=path.stat().st_size)
        return row if row.state != "cut" or row.message else replace(row, message=ENDED)

    def _make_room(self) -> None:
        """Delete the oldest records where the disk is nearly full; OSError when that does not help."""
        make_folder(self._folder.folder)
        groups = list(self._folder.groups().values())
        while room(self._folder.folder) <= 0:
            if not groups:
                raise OSError("the disk is nearly full; what is left is the database's")
            self._delete(groups.pop(0))

    def _prune(self) -> None:
        """Delete the oldest records until their number, size and age are within bounds; the newest stays."""
        try:
            groups = list(self._folder.groups().values())
            sizes = [sum(path.stat().st_size for path in paths) for paths in groups]
            while len(groups) > 1 and self._too_much(groups, sizes):
                self._delete(groups.pop(0))
                sizes.pop(0)
            if isfinite(self._limits.keep):
                self._ages.keep(paths[0].name for paths in groups)
        except OSError as error:
            log.warning("%s: old event records cannot be deleted: %s", self._facts.rig, error)

    def _too_much(self, groups: Sequence[Sequence[Path]], sizes: Sequence[int]) -> bool:
        old = self._ages.of(groups[0][0].name) > self._limits.keep
        return old or len(groups) > self._limits.max_count or sum(sizes) > self._limits.max_mb * 1e6

    def _delete(self, paths: Sequence[Path]) -> None:
        """Delete a record's files and say so in the index."""
        for path in paths:
            path.unlink(missing_ok=True)
        numbers = {self._folder.number(path.name) for path in paths}
        for file in [file for file in self._rows if self._folder.number(Path(file).name) in numbers]:
            self._publish([replace(self._rows.pop(file), state="purged")])


def _state(job: Job, *, whole: bool = False) -> bytes:
    """Return what was known before a record's samples, and the rounds up to its last alarm.

    whole: with their samples, which a record of one source holds beside it.
    """
    if job.state is None:
        return b""
    items = [item for item in job.items if item.round <= job.last_round]
    return state_bytes(job.state, Rounds(None, items, job.labels, job.moduli), (0, -1) if whole else job.span)


def _after_restart(row: EventRecord, there: set[str]) -> EventRecord | None:
    """Return what a row of an earlier run becomes; None when it stays as it is."""
    name = Path(row.file).name
    left = name in there if "*" not in name else any(other.startswith(name.split("*")[0]) for other in there)
    if row.state in {"purged", "failed"}:
        return None
    if not left:
        return replace(row, state="purged")
    if row.state == "recording":
        return replace(row, state="cut", message=ENDED)
    return None
