"""An agent that is asked to end, or whose time is over, ends within three seconds whatever its database is
doing."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.config import load
from agent.errors import StoreError
from agent.runtime.service import END_S, RigRuntime, Service
from agent.storage.read import queries
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.scenario.live import example
from tests.storage.rows import batch, run_info

pytestmark = pytest.mark.realtime
MOST_S = 3.0
ENDLESS = "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT count(*) FROM n"
LONG_S = 20.0


def took_s(act: Callable[[], object]) -> float:
    begun = time.monotonic()
    act()
    return time.monotonic() - begun


@pytest.mark.parametrize("duration_s", [None, 0.3])
def test_agent_that_ends_while_a_database_is_repaired_does_not_wait_for_it(
    duration_s: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = threading.Event()
    monkeypatch.setattr(StoreWriter, "start", lambda _: over.wait(LONG_S))
    service = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    if duration_s is None:
        threading.Timer(0.3, service.stop).start()
    try:
        assert took_s(lambda: service.run(duration_s)) < 0.3 + MOST_S
    finally:
        over.set()


def test_database_that_cannot_be_opened_is_an_error_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: StoreWriter) -> None:
        raise StoreError.at("rig.db", "is none", "take another")

    monkeypatch.setattr(StoreWriter, "start", refuse)
    with pytest.raises(StoreError, match="is none"):
        Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live").run(5.0)


def test_agent_that_ends_while_its_database_purges_breaks_that_off_and_stores_its_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    (writer,) = service.writers.values()
    purging = threading.Event()

    def purge(keeper: object, *, finish: bool = False) -> None:
        del finish
        purging.set()
        store = keeper._store  # type: ignore[attr-defined]
        if not store.hurried:
            store.connection.execute(ENDLESS).fetchall()

    monkeypatch.setattr("agent.storage.write.retention.TierKeeper.step", purge)
    ended = threading.Thread(target=service.run, args=(None,))
    ended.start()
    assert purging.wait(LONG_S)
    writer.publish([batch(3, rig="two-mass-rig")])
    service.stop()
    ended.join(MOST_S)
    assert not ended.is_alive()
    assert not writer.is_alive()
    assert len(queries.estimates(tmp_path / "rig.db")) == 12


def test_agent_that_ends_leaves_what_cannot_be_broken_off_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    over, busy = threading.Event(), threading.Event()

    def stuck(_: Store, *, finish: bool = False) -> None:
        del finish
        busy.set()
        over.wait(LONG_S)

    monkeypatch.setattr(Store, "maintain", stuck)
    service = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    ended = threading.Thread(target=service.run, args=(None,))
    ended.start()
    assert busy.wait(LONG_S)
    service.stop()
    ended.join(MOST_S)
    over.set()
    assert not ended.is_alive()
    assert "is busy for longer than the end may take" in caplog.text
    assert END_S < MOST_S


def test_agent_that_ends_while_it_computes_breaks_that_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    busy = threading.Event()

    def compute(_: RigRuntime) -> None:
        busy.set()
        until = time.monotonic() + LONG_S
        while time.monotonic() < until:
            pass

    monkeypatch.setattr(RigRuntime, "work", compute)
    service = Service([load(example("modbus", tmp_path))], tmp_path / "rig.db", "live")
    ended = threading.Thread(target=service.run, args=(None,))
    ended.start()
    assert busy.wait(LONG_S)
    begun = time.monotonic()
    service.stop()
    ended.join(LONG_S)
    assert time.monotonic() - begun < MOST_S
    assert "what was being computed at the end is not stored" in caplog.text


def test_compacting_is_broken_off_with_an_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Store.open(tmp_path / "rig.db") as store:
        monkeypatch.setattr(store, "_finished", lambda _: Store._finished(store, lambda: _endless(store)))
        threading.Timer(0.2, store.hurry).start()
        with pytest.raises(StoreError, match="its agent is ending"):
            store.compact()


def _endless(store: Store) -> None:
    store.connection.execute(ENDLESS).fetchall()


def test_store_in_a_hurry_purges_nothing_and_the_next_start_does(tmp_path: Path) -> None:
    path, rows = tmp_path / "rig.db", batch(600, hop_ns=60 * 10**9)
    with Store.open(path, Retention(full_s=3600.0)) as store:
        store.write(store.begin_run(run_info()), [rows])
        store.hurry()
        store.maintain()
        store.maintain(finish=True)
        assert _hops(store) == 600
    with Store.open(path, Retention(full_s=3600.0)) as store:
        store.write(store.begin_run(run_info()), [batch(3, first=600, hop_ns=60 * 10**9)])
        store.maintain()
        assert _hops(store) < 200


def _hops(store: Store) -> int:
    return int(store.connection.execute("SELECT count(*) FROM hops WHERE span = 0").fetchone()[0])
