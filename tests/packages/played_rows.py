"""What an agent writes, played: a new run, and rows up to now that are all valid or all not."""

from pathlib import Path
from typing import Any

import numpy as np

from agent.clock import wall_ns
from agent.storage.write.store import Store
from agent.types import EstimateBatch, Status
from tests.storage.rows import HOP, batch, run_info

HOPS = 20


def rows(status: Status) -> EstimateBatch:
    """Return the rows of the last second."""
    changes: dict[str, Any] = {}
    if status is not Status.VALID:
        nothing = np.full((HOPS, 4), np.nan)
        changes = dict.fromkeys(("value", "sd", "sd_repeat", "lower", "upper"), nothing)
        changes |= {"status": np.full((HOPS, 4), status, np.uint8), "dof": np.full(HOPS, np.nan)}
    return batch(HOPS, start=wall_ns() - HOPS * HOP, **changes)


def write_rows(db: Path, status: Status = Status.VALID) -> None:
    """Write a run of one second."""
    with Store.open(db) as store:
        run = store.begin_run(run_info(started_ns=wall_ns() - HOPS * HOP))
        store.write(run, [rows(status)])
