"""What a rig's windows have taught: one row a run, the newest of which the next start begins with."""

import json
import sqlite3

from agent.records import LearntRecord
from agent.storage.database.checksum import checked
from agent.storage.tables.rows import Numbers, Plan

_NEWEST = """SELECT c.seq, c.run_id, c.t_ns, c.key, c.content, c.crc
 FROM learnt c JOIN runs r ON r.seq = c.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE g.name = ? AND r.kind = ? AND c.key = ? ORDER BY c.seq DESC"""


class LearntRows:
    """Which row each run has; a run that learns more changes its row."""

    def __init__(self) -> None:
        self._rows: dict[int, int] = {}

    def apply(self, plan: Plan, record: LearntRecord, run_id: int, numbers: Numbers) -> None:
        """Add what a run knows now to a plan."""
        if run_id not in self._rows:
            self._rows[run_id] = numbers.take("learnt")
        plan.sealed(
            "learnt", self._rows[run_id], run_id, record.t_ns, record.learnt.key, record.learnt.content
        )


def newest_learnt(connection: sqlite3.Connection, rig: str, kind: str, key: str) -> str | None:
    """Return what runs of a rig of one kind learnt last for a key, as JSON text; None for nothing.

    Whatever version of the code wrote it: the content says so itself. A damaged row is passed over.
    """
    for cells in map(checked, connection.execute(_NEWEST, (rig, kind, key))):
        if cells is not None and _is_json(content := str(cells[-1])):
            return content
    return None


def _is_json(text: str) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True
