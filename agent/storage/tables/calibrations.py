"""What was learnt of a rig's disturbances: one row a run, the newest of which the next start begins with."""

import json
import sqlite3
from dataclasses import asdict

from agent.storage.tables.rows import Numbers, Plan
from agent.types import Calibrated, CalibrationRecord, RunInfo


class CalibrationRows:
    """Which row each run has; a run that learns more changes its row."""

    def __init__(self) -> None:
        self._rows: dict[int, int] = {}

    def apply(self, plan: Plan, record: CalibrationRecord, run_id: int, numbers: Numbers) -> None:
        """Add what a run knows now to a plan."""
        if run_id not in self._rows:
            self._rows[run_id] = numbers.take("calibrations")
        content = json.dumps(asdict(record.calibrated), sort_keys=True, allow_nan=False)
        plan.sealed("calibrations", self._rows[run_id], run_id, record.t_ns, content)


_NEWEST = """SELECT c.content FROM calibrations c JOIN runs r ON r.seq = c.run_id JOIN rigs g ON g.seq = r.rig_id
 WHERE g.name = ? AND r.config_sha256 = ? AND r.kind = ? AND r.code_version = ? ORDER BY c.seq DESC LIMIT 1"""


def newest_calibration(connection: sqlite3.Connection, run: RunInfo) -> Calibrated | None:
    """Return what runs of a rig with the same configuration, kind and code version learnt last; None for nothing."""
    found = connection.execute(_NEWEST, (run.rig, run.config_sha256, run.kind, run.code_version)).fetchone()
    if found is None:
        return None
    content = json.loads(found[0])
    factor = content["factor"]
    return Calibrated(
        tuple(content["sigma"]), tuple(content["process"]), None if factor is None else tuple(factor),
        bool(content["searched"]),
    )  # fmt: skip
