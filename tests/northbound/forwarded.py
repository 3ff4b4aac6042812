"""Databases of rigs that wear, and all their rows handed to a consumer at once."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.prognosis.fleet import fleet
from agent.northbound.interface.peer import Batch, Peer
from agent.storage.read.forward import Feed
from agent.storage.write.store import Store
from tests.storage.rows import batch, run_info, step

SECOND = 1_000_000_000
TOPICS = ("estimates", "alarms")


def worn(folder: Path, rig: str, count: int, hop_s: int) -> Path:
    """Write a database of rows of which k1 falls and k2 stays; an alarm of k1 had a limit of its own."""
    rows = batch(count, rig=rig, hop_ns=hop_s * SECOND, parameters=("k1", "k2"))
    value = rows.value - np.linspace(0.0, 3.0, count)[:, None] * np.array([1.0, 0.0])
    path = folder / f"{rig}.db"
    with Store.open(path) as store:
        run = store.begin_run(replace(run_info(), rig=rig))
        store.write(run, [replace(rows, value=value), step("NORM", "UNACK", rig=rig, limit_value=7.5)])
        store.maintain(finish=True)
    return path


def forwarded(path: Path, peer: Peer) -> None:
    """Hand all rows of a database to a consumer, in batches."""
    feed = Feed(path)
    peer.open()
    for topic in TOPICS:
        cursor, more = 0, True
        while more:
            chunk = feed.after(topic, cursor, None, 700)
            if chunk.rows:
                peer.deliver(Batch(topic, chunk.rows, cursor, backfill=False))
            cursor, more = chunk.reached, chunk.more
    peer.close()
    feed.close()


def same(rows: Sequence[dict[str, Any]], path: Path) -> bool:
    """Tell whether rows of `fleet` are those of databases, but for how forecasts were, which is not sent."""
    expected = fleet([path], "90d", None, 20.0)["rows"]
    assert {row["parameter"] for row in expected if row["trend"]} >= {"k1"}
    for row in (*rows, *expected):
        del row["p50_at"]  # what p50_s says, as a date
    wanted = [{name: _nearly(cell) for name, cell in (row | {"record": None}).items()} for row in expected]
    return list(rows) == wanted


def _nearly(cell: Any) -> Any:
    return pytest.approx(cell, rel=1e-9) if isinstance(cell, float) else cell
