"""The ledger of each source has one row an instant, and the last one told counts."""

from pathlib import Path

import pytest

from agent.records import Health
from agent.storage.write.store import Store
from tests.storage.rows import START, ledger, run_info, select

WHAT = "SELECT source, t_ns, received, lag_s FROM v_health ORDER BY source, t_ns"
AGAIN = ledger(received=1010, used=997, rejected={"crc": 8}, lag_s=9.0)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


def test_ledger_told_again_at_the_same_instant_is_one_row(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        store.write(run_id, [ledger(START - 10**10, received=1), ledger()])
        store.write(run_id, [AGAIN])
    assert select(path, WHAT) == [("can", START - 10**10, 1, 0.01), ("can", START, 1010, 9.0)]
    reasons = f"SELECT reason, count FROM v_health_reasons WHERE kind = 'rejected' AND t_ns = {START}"
    assert select(path, reasons) == [("crc", 8)]


def test_ledger_told_twice_in_one_transaction_is_one_row_whose_checksum_holds(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info(kind="replay"))
        plans = store.encode(run_id, [ledger(), AGAIN])
        store.commit(plans)
        store.commit(plans)
    with Store.open(path) as store:
        assert store.recovery is None
    assert select(path, WHAT) == [("can", START, 1010, 9.0)]


def test_ledgers_of_other_sources_and_runs_at_an_instant_stay(path: Path) -> None:
    both: list[Health] = [ledger(), ledger(source="plc", received=7)]
    with Store.open(path) as store:
        for run_id in (store.begin_run(run_info()), store.begin_run(run_info())):
            store.write(run_id, both)
            store.write(run_id, both)
    assert select(path, "SELECT count(*) FROM health") == [(4,)]


def test_ledger_of_a_standstill_takes_no_more_room(path: Path) -> None:
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for hours in range(500):
            store.write(run_id, [ledger(lag_s=float(hours))])
    assert select(path, WHAT) == [("can", START, 1000, 499.0)]
