"""Records as rows: what the rows of each open run need to know of the file, and of the rows before them."""

import json
import logging
import sqlite3
from collections.abc import Callable, Sequence

import numpy as np

from agent.records import (
    ClockRecord,
    EventRecord,
    ForecastScore,
    Health,
    HealthEvent,
    LearntRecord,
    Record,
    RunInfo,
)
from agent.storage.tables.ages import jump_words
from agent.storage.tables.alarms import AlarmRow, AlarmRows
from agent.storage.tables.clocks import ClockRows, Coverage, add_run
from agent.storage.tables.estimates import add_estimates, joined_runs
from agent.storage.tables.records import EventRecordRows, HealthRows, LearntRows, add_one_row, add_score
from agent.storage.tables.rows import Names, Numbers, Plan
from agent.storage.tuning import CELLS_A_COMMIT
from agent.types import AlarmTransition, EstimateBatch

log = logging.getLogger(__name__)


class RunRows:
    """The open runs of one file.

    Args:
        names, numbers: those of the file.
        connection: returns its writing connection, which only some records need.
        watch: called with the numbers of a run and of the part of it that rows are of from now on.
        settings: of the clock of each rig's run, where it goes on in this file.
    """

    def __init__(
        self,
        names: Names,
        numbers: Numbers,
        connection: Callable[[], sqlite3.Connection],
        watch: Callable[[int, int], None],
        settings: dict[str, list[ClockRecord]],
    ) -> None:
        self._names, self._numbers, self._connection, self._watch = names, numbers, connection, watch
        self._alarms: dict[int, AlarmRows] = {}
        self._clocks: dict[int, ClockRows] = {}
        self._settings = settings
        self._coverage: dict[int, Coverage] = {}
        self._records = EventRecordRows()
        self._learnt = LearntRows()
        self._health = HealthRows()

    def __contains__(self, run_id: int) -> bool:
        return run_id in self._alarms

    def open(self, run_id: int, run: RunInfo, alarms: AlarmRows) -> None:
        """Begin a run; after the file was replaced its clock is as it was."""
        self._alarms[run_id] = alarms
        self._clocks[run_id] = ClockRows(run_id, self._names.rig(run.rig), run)
        self._covered(run_id, run_id, run.rig)
        self._watch(run_id, run_id)
        for record in self._settings.pop(run.rig, ()):
            self._watch(run_id, self._clocks[run_id].apply(record, self._numbers))

    def close(self, run_id: int) -> None:
        """Forget a run that ended, all of whose rows are stored: its alarms go on in the rig's next."""
        self._alarms.pop(run_id, None)
        self._clocks.pop(run_id, None)

    def standing(self, rig: str | None = None, kind: str | None = None) -> list[AlarmRow]:
        """Return alarms of open runs that are not back to normal; of one rig and kind of run where named."""
        return [row for run_id in self._of(rig, kind) for row in self._alarms[run_id].standing]

    def take_up(self, rig: str, kind: str, row: AlarmRow) -> None:
        """Go on with an alarm as an operator left it."""
        for run_id in self._of(rig, kind):
            self._alarms[run_id].take_up(row)

    def clock(self, rig: str, kind: str) -> tuple[int, int | None]:
        """Return the part a rig's stamps are of now, and wall minus monotonic clock; 0, None for none."""
        found = [self._clocks[run_id] for run_id in self._of(rig, kind)]
        return (found[-1].newest, found[-1].offset_ns) if found else (0, None)

    def _of(self, rig: str | None, kind: str | None) -> list[int]:
        runs = ((run_id, clock.run) for run_id, clock in self._clocks.items())
        return [run_id for run_id, run in runs if rig in {None, run.rig} and kind in {None, run.kind}]

    def settings(self) -> dict[str, list[ClockRecord]]:
        """Return what is known of the clock of each rig's run."""
        return {clock.run.rig: clock.records for clock in self._clocks.values()}

    def plans(self, run_id: int, records: Sequence[Record]) -> list[Plan]:
        """Turn records of an open run into the rows of one or several transactions."""
        clocks = [record for record in records if isinstance(record, ClockRecord)]
        news = [event for record in clocks for event in self._set_clock(run_id, record)]
        plans = [self._estimates_plan(run_id, part) for part in _pieces(records)] or [Plan()]
        for record in (*records, *news):
            self._add(plans[-1], run_id, record)
        return plans

    def _set_clock(self, run_id: int, record: ClockRecord) -> list[HealthEvent]:
        """Take in how the wall clock is set; return the event of a run that begins with another setting."""
        clock = self._clocks[run_id]
        words = None if clock.records else jump_words(self._connection(), clock.run, run_id, record)
        self._watch(run_id, clock.apply(record, self._numbers))
        if words is None:
            return []
        log.warning("%s", f"{record.rig}: {words}")
        return [HealthEvent(record.rig, "clock", record.t_ns, "clock step", words)]

    def _estimates_plan(self, run_id: int, batch: EstimateBatch) -> Plan:
        plan = Plan()
        clock = self._clocks[run_id]
        for part, rows in clock.split(batch, self._names, self._numbers):
            add_estimates(plan, rows, part, self._names, self._numbers)
            t_ns = rows.t_ns
            self._covered(run_id, part, batch.rig).extend(
                plan, int(np.min(t_ns)), int(np.max(t_ns)), self._numbers
            )
        return plan

    def _covered(self, run_id: int, part: int, rig: str) -> Coverage:
        if part not in self._coverage:
            self._coverage[part] = Coverage(self._connection(), run_id, part, rig)
        return self._coverage[part]

    def _add(self, plan: Plan, run_id: int, record: Record) -> None:
        if isinstance(record, AlarmTransition):
            self._alarms[run_id].apply(plan, record, self._numbers)
        elif isinstance(record, Health):
            self._health.apply(plan, record, self._clocks[run_id].newest, self._numbers)
        elif isinstance(record, LearntRecord):
            self._learnt.apply(plan, record, run_id, self._numbers)
        elif isinstance(record, ForecastScore):
            add_score(plan, record, self._connection())
        elif isinstance(record, EventRecord):
            self._records.apply(plan, record, run_id, self._numbers, self._connection())
        else:
            add_one_row(plan, record, run_id, self._numbers)


def run_plan(run_id: int, run: RunInfo, names: Names, numbers: Numbers) -> Plan:
    """Return the rows of a run that begins: what it is, where its machine stands, the graph of its model."""
    plan = Plan()
    add_run(plan, run_id, names.rig(run.rig), run, run.started_ns)
    if run.site or run.labels:
        labels = json.dumps(dict(run.labels), ensure_ascii=False) if run.labels else None
        plan.sealed("sites", numbers.take("sites"), run_id, run.site, labels)
    if run.graph is not None:
        plan.sealed("graphs", numbers.take("graphs"), run_id, run.graph)
    return plan


def _pieces(records: Sequence[Record]) -> list[EstimateBatch]:
    """Return the estimates of the records, joined where they can be and cut to the size of a transaction."""
    pieces: list[EstimateBatch] = []
    batches = [r for r in records if isinstance(r, EstimateBatch) and len(r)]
    for batch in joined_runs(batches):
        hops = max(1, CELLS_A_COMMIT // max(1, len(batch.parameters)))
        if len(batch) <= hops:
            pieces.append(batch)
            continue
        pieces.extend(batch.part(np.arange(i, min(i + hops, len(batch)))) for i in range(0, len(batch), hops))
    return pieces
