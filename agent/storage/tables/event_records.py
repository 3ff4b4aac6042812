"""The index of event records: which file beside the database holds the raw samples around which alarm."""

import sqlite3

from agent.records import EventRecord
from agent.storage.tables.rows import Numbers, Plan


class EventRecordRows:
    """Which row each file has; a record that changes (complete, purged) changes its row."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[int, int]] = {}

    def apply(
        self, plan: Plan, record: EventRecord, run_id: int, numbers: Numbers, connection: sqlite3.Connection
    ) -> None:
        """Add a record's row as it is now to a plan, under the run that began it."""
        seq, run = self._row(record, run_id, numbers, connection)
        plan.sealed(
            "event_records", seq, run, record.t_ns, record.kind, record.parameter, record.alarms, record.file,
            record.state, record.from_ns, record.to_ns, record.samples, record.bytes, record.baseline_id,
            record.message,
        )  # fmt: skip

    def _row(
        self, record: EventRecord, run_id: int, numbers: Numbers, connection: sqlite3.Connection
    ) -> tuple[int, int]:
        if record.file not in self._rows:
            query = "SELECT seq, run_id FROM event_records WHERE file = ? ORDER BY seq DESC LIMIT 1"
            known = connection.execute(query, (record.file,)).fetchone()
            self._rows[record.file] = known or (numbers.take("event_records"), run_id)
        return self._rows[record.file]
