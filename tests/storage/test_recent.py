"""What is new after a cursor comes once, in order, in pages of any size."""

from pathlib import Path

import pytest

from agent.storage.read import recent
from agent.storage.write.store import Store
from tests.storage.rows import HOP, START, batch, ledger, run_info, step


@pytest.fixture
def path(memory: Path) -> Path:
    """Two rigs whose rows were committed by turns, an alarm raised and cleared, two ledger rows."""
    path = memory / "rig.db"
    with Store.open(path) as store:
        one, two = store.begin_run(run_info()), store.begin_run(run_info("press-8"))
        store.write(one, [batch(20), step("NORM", "UNACK"), ledger()])
        store.write(two, [batch(10, rig="press-8", parameters=("k1", "c9"))])
        store.write(
            one,
            [batch(20, first=20), step("UNACK", "NORM", START + HOP), ledger(START + 10**10, received=3000)],
        )
    return path


@pytest.mark.parametrize("most", [1, 7, 1000])
def test_changes_in_pages_come_once_in_order_and_whole(path: Path, most: int) -> None:
    cursor, found = recent.Cursor(), []
    while True:
        page, after = recent.changes(path, cursor, most)
        found += page
        if after == cursor:
            break
        cursor = after
    assert cursor == recent.newest(path)
    instants = [change.document for change in found if change.kind == "estimates"]
    assert [(d["rig"], d["t_ns"]) for d in instants] == [
        *(("press-7", START + i * HOP) for i in range(20)),
        *(("press-8", START + i * HOP) for i in range(10)),
        *(("press-7", START + i * HOP) for i in range(20, 40)),
    ]
    assert {len(d["rows"]) for d in instants if d["rig"] == "press-7"} == {4}
    steps = [change.document for change in found if change.kind == "alarm"]
    assert [(d["from_state"], d["to_state"], d["alarm"]["rig"]) for d in steps] == [
        ("NORM", "UNACK", "press-7"), ("UNACK", "NORM", "press-7"),
    ]  # fmt: skip
    assert len({str(change.cursor) for change in found if change.kind == "alarm"}) == 2


def test_cursor_reads_what_it_writes_and_nothing_else() -> None:
    assert recent.Cursor.read(str(recent.Cursor(3, 14))) == recent.Cursor(3, 14)
    for text in ("", "3", "-1.2", "3.x", "3.4.5", "9" * 30 + ".1", "١.٢"):
        assert recent.Cursor.read(text) is None


def test_sources_have_the_rate_between_their_newest_rows(path: Path) -> None:
    (row,) = recent.sources(path)
    assert (row["rig"], row["source"], row["rate_hz"]) == ("press-7", "can", 200.0)


def test_alarm_events_name_their_rig(path: Path) -> None:
    assert [(r["rig"], r["to_state"]) for r in recent.alarm_events(path)] == [
        ("press-7", "UNACK"),
        ("press-7", "NORM"),
    ]
    assert recent.alarm_events(path, "press-8") == []
