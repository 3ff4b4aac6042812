"""Of what happened the newest rows are kept, whatever the clock said; what stands is never deleted."""

from pathlib import Path

import pytest

from agent.records import EventRecord, HealthEvent
from agent.storage.database.verify import problems
from agent.storage.read import queries
from agent.storage.tuning import KEPT_RECORDS
from agent.storage.write.retention import purge_logs
from agent.storage.write.store import Store
from tests.storage.rows import START, batch, run_info, step

SECOND = 10**9


def filled(path: Path, order: int) -> None:
    """Write events and alarms whose stamps run ahead (1) or back (-1), the first alarm still standing."""
    with Store.open(path) as store:
        run = store.begin_run(run_info())
        store.write(run, [step("NORM", "UNACK", START, parameter="k2")])
        for i in range(1, 9):
            t_ns = START + order * i * SECOND
            store.write(run, [HealthEvent("press-7", "can", t_ns, "gap", f"event {i}")])
            store.write(run, [step("NORM", "UNACK", t_ns), step("UNACK", "RTNUN", t_ns + 1)])
            state = "purged" if i < 6 else "complete"
            file = f"e/press-7-{i}-k1.npz"
            store.write(
                run, [EventRecord("press-7", t_ns, "level", "k1", 1, file, state, t_ns, t_ns, 9, 9, None)]
            )


@pytest.mark.parametrize("order", [1, -1])
def test_oldest_rows_beyond_a_number_go_but_what_stands(tmp_path: Path, order: int) -> None:
    path = tmp_path / "rig.db"
    filled(path, order)
    with Store.open(path) as store:
        with store.transaction() as connection:
            purge_logs(connection, kept=2)
        assert problems(store.connection) == []
        left = store.connection.execute("SELECT count(*) FROM alarm_events").fetchone()[0]
    assert [row["message"] for row in queries.events(path)] == ["event 7", "event 8"]
    assert [row["parameter"] for row in queries.alarms(path)] == ["k2", "k1", "k1"]
    assert left == 1 + 2 * 2
    assert [row["id"] for row in queries.event_records(path)] == [6, 7, 8]


def test_purge_by_the_hour_bounds_what_happened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "rig.db"
    filled(path, 1)
    monkeypatch.setattr("agent.storage.write.retention.purge_logs.__defaults__", (3,))
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(3)])
        store.maintain()
    assert len(queries.events(path)) == 3
    assert KEPT_RECORDS >= 10_000
