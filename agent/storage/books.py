"""Records as rows: what the rows of each open run need to know of the file, and of the rows before them."""

import sqlite3
from collections.abc import Callable, Sequence

import numpy as np

from agent.storage.alarms import AlarmBook
from agent.storage.batches import joined_runs, take
from agent.storage.calibrations import CalibrationBook
from agent.storage.coverage import Coverage
from agent.storage.encode import add_estimates
from agent.storage.event_records import RecordBook
from agent.storage.rows import Names, Numbers, Plan
from agent.storage.status import HealthBook, add_event
from agent.types import (
    AlarmTransition,
    CalibrationRecord,
    EstimateBatch,
    EventRecord,
    Health,
    HealthEvent,
    Record,
)

_CELLS_A_COMMIT = 20_000  # about 1.2 MB of write-ahead log


class Books:
    """The open runs of one file.

    Args:
        names, numbers: those of the file.
        connection: returns its writing connection, which only some records need.
    """

    def __init__(self, names: Names, numbers: Numbers, connection: Callable[[], sqlite3.Connection]) -> None:
        self._names, self._numbers, self._connection = names, numbers, connection
        self._alarms: dict[int, AlarmBook] = {}
        self._coverage: dict[int, Coverage] = {}
        self._records, self._calibrations, self._health = RecordBook(), CalibrationBook(), HealthBook()

    def __contains__(self, run_id: int) -> bool:
        return run_id in self._alarms

    def open(self, run_id: int, alarms: AlarmBook, coverage: Coverage) -> None:
        """Begin the books of a run."""
        self._alarms[run_id], self._coverage[run_id] = alarms, coverage

    def plans(self, run_id: int, records: Sequence[Record]) -> list[Plan]:
        """Turn records of an open run into the rows of one or several transactions."""
        plans = [self._estimates_plan(run_id, part) for part in _pieces(records)] or [Plan()]
        for record in records:
            self._add(plans[-1], run_id, record)
        return plans

    def _estimates_plan(self, run_id: int, batch: EstimateBatch) -> Plan:
        plan = Plan()
        add_estimates(plan, batch, run_id, self._names, self._numbers)
        t_ns = batch.t_ns
        self._coverage[run_id].extend(plan, int(np.min(t_ns)), int(np.max(t_ns)), self._numbers)
        return plan

    def _add(self, plan: Plan, run_id: int, record: Record) -> None:
        if isinstance(record, AlarmTransition):
            self._alarms[run_id].apply(plan, record, self._numbers)
        elif isinstance(record, Health):
            self._health.apply(plan, record, run_id, self._numbers)
        elif isinstance(record, HealthEvent):
            add_event(plan, record, run_id, self._numbers)
        elif isinstance(record, CalibrationRecord):
            self._calibrations.apply(plan, record, run_id, self._numbers)
        elif isinstance(record, EventRecord):
            self._records.apply(plan, record, run_id, self._numbers, self._connection())


def _pieces(records: Sequence[Record]) -> list[EstimateBatch]:
    """Return the estimates of the records, joined where they can be and cut to the size of a transaction."""
    pieces: list[EstimateBatch] = []
    batches = [r for r in records if isinstance(r, EstimateBatch) and len(r)]
    for batch in joined_runs(batches):
        hops = max(1, _CELLS_A_COMMIT // max(1, len(batch.parameters)))
        if len(batch) <= hops:
            pieces.append(batch)
            continue
        pieces.extend(take(batch, np.arange(i, min(i + hops, len(batch)))) for i in range(0, len(batch), hops))
    return pieces
