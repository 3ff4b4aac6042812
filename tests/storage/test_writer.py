import errno
import sqlite3
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from agent.errors import StoreError
from agent.storage.read import queries
from agent.storage.read.selection import reading
from agent.storage.tables.rows import Plan
from agent.storage.write.backlog import Backlog, Pause
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.text import iso_time
from agent.types import AlarmTransition, EstimateBatch
from tests.storage.rows import HOP, START, batch, ledger, run_info, step

LONG = 60.0  # s; a writer that only acts when it must


class Sick(Store):
    """A store whose commits fail while `cause` is set; `commits` counts those that went through."""

    cause: sqlite3.Error | None = None
    gate: threading.Event | None = None
    commits = 0

    def _transaction(self, plan: Plan) -> None:
        if self.gate is not None:
            assert self.gate.wait(20)
        if Sick.cause is not None:
            raise Sick.cause
        super()._transaction(plan)
        self.commits += 1


def error(code: int, text: str) -> sqlite3.OperationalError:
    problem = sqlite3.OperationalError(text)
    problem.sqlite_errorcode = code
    return problem


FULL = error(sqlite3.SQLITE_FULL, "database or disk is full")
SYNC = error(sqlite3.SQLITE_IOERR_FSYNC, "disk I/O error")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.db"


@pytest.fixture
def make(path: Path) -> Iterator[Callable[..., StoreWriter]]:
    made: list[StoreWriter] = []

    def writer(**options: Any) -> StoreWriter:
        new = StoreWriter(lambda: Sick.open(path), [run_info()], **({"period_s": LONG} | options))
        made.append(new)
        new.start()
        return new

    Sick.cause = None
    yield writer
    Sick.cause = None
    for new in made:
        new.stop()
        assert not new.is_alive()


def test_writer_flush_commits_what_was_published(path: Path, make: Callable[..., StoreWriter]) -> None:
    writer = make()
    for i in range(30):
        writer.publish([batch(1, first=i)])
    writer.publish([ledger()])
    assert writer.flush(20)
    assert len(queries.estimates(path)) == 120
    assert writer.written == 121
    assert writer.run_ids == {"press-7": 1}


def test_writer_commits_alarms_at_once_and_the_rest_in_batches(
    path: Path, make: Callable[..., StoreWriter]
) -> None:
    seen = threading.Event()
    real = Sick._transaction

    def watched(self: Sick, plan: Plan) -> None:
        real(self, plan)
        if "alarms" in plan.rows:
            seen.set()

    Sick._transaction = watched  # type: ignore[method-assign]
    try:
        writer = make()
        before = writer._store.commits
        for i in range(5):
            writer.publish([batch(1, first=i)])
        assert writer._store.commits == before
        writer.publish([step("NORM", "UNACK")])
        assert seen.wait(20)
    finally:
        Sick._transaction = real  # type: ignore[method-assign]
    assert writer.flush(20)
    assert writer._store.commits == before + 1
    assert len(queries.estimates(path)) == 20


def test_writer_stop_writes_what_is_left(path: Path, make: Callable[..., StoreWriter]) -> None:
    writer = make(every_s=1.0)
    writer.publish([batch(50)])
    writer.stop(20)
    assert [r["t_ns"] for r in queries.estimates(path, parameter="k1")] == [
        START + i * HOP for i in (19, 39, 49)
    ]
    assert writer.dropped == {}


@pytest.mark.parametrize(("problem", "cause"), [(FULL, "disk full"), (SYNC, "input output error")])
def test_writer_keeps_at_it_while_the_disk_fails_and_says_so(
    path: Path,
    make: Callable[..., StoreWriter],
    caplog: pytest.LogCaptureFixture,
    problem: sqlite3.Error,
    cause: str,
) -> None:
    writer = make()
    Sick.cause = problem
    writer.publish([batch(10), step("NORM", "UNACK")])
    assert not writer.flush(0.3)
    assert writer.failing == cause
    writer.publish([batch(10, first=10)])
    Sick.cause = None
    assert writer.flush(20)
    assert writer.failing is None
    assert len(queries.estimates(path)) == 80
    (event,) = [e for e in queries.events(path) if e["source"] == "store"]
    assert event["cause"] == cause
    assert event["t_ns"] == START + 19 * HOP
    (alarm,) = [a for a in queries.alarms(path) if a["parameter"] == "store"]
    assert (alarm["kind"], alarm["priority"], alarm["state"]) == ("source", "high", "RTNUN")
    assert (alarm["raised_at"], alarm["cleared_at"]) == (
        iso_time(START + 9 * HOP),
        iso_time(START + 19 * HOP),
    )
    assert [r.getMessage().split(": ", 1)[1][:20] for r in caplog.records if r.levelname == "WARNING"] == [
        "cannot be written (i" if problem is SYNC else "cannot be written (d", "can be written again",
    ]  # fmt: skip
    assert writer.dropped == {}


def test_writer_bounds_what_waits_and_counts_what_it_drops_but_no_alarm(
    path: Path, make: Callable[..., StoreWriter]
) -> None:
    writer = make(most_cells=400)
    Sick.cause = FULL
    writer.publish([step("NORM", "UNACK")])
    assert not writer.flush(0.1)
    for i in range(20):
        writer.publish([batch(10, first=10 * i)])
        assert not writer.flush(0.02)
    Sick.cause = None
    assert writer.flush(20)
    rows = queries.estimates(path)
    assert writer.dropped["disk full"] + len(rows) == 800
    assert len(rows) <= 480
    assert rows[-1]["t_ns"] == START + 199 * HOP
    assert [a["parameter"] for a in queries.alarms(path)] == ["k1", "store"]
    assert str(writer.dropped["disk full"]) in queries.events(path)[-1]["message"]


def test_writer_that_cannot_keep_up_never_blocks_the_pipeline(
    path: Path, make: Callable[..., StoreWriter]
) -> None:
    writer = make(most_cells=400)
    gate = writer._store.gate = threading.Event()
    for i in range(60):
        writer.publish([batch(10, first=10 * i), step("NORM" if i % 2 == 0 else "UNACK", "UNACK", START + i)])
    dropped = writer.dropped["queue full"]
    assert dropped >= 1600
    gate.set()
    assert writer.flush(20)
    assert len(queries.estimates(path)) + sum(writer.dropped.values()) == 2400
    with reading(path) as connection:
        assert connection.execute("SELECT count(*) FROM v_alarm_events").fetchone() == (60,)


def test_writer_lossless_waits_for_the_disk(path: Path, make: Callable[..., StoreWriter]) -> None:
    writer = make(lossless=True, most_cells=400)
    gate = writer._store.gate = threading.Event()
    done = threading.Event()

    def pour() -> None:
        for i in range(60):
            writer.publish([batch(10, first=10 * i)])
        done.set()

    thread = threading.Thread(target=pour)
    thread.start()
    assert not done.wait(0.2)
    gate.set()
    assert done.wait(20)
    thread.join()
    assert writer.flush(20)
    assert len(queries.estimates(path)) == 2400
    assert writer.dropped == {}


def test_writer_lossless_tells_of_a_failing_disk(path: Path) -> None:
    writer = StoreWriter(lambda: Sick.open(path), [run_info()], lossless=True)
    Sick.cause = None
    writer.start()
    Sick.cause = FULL
    writer.publish([batch(1)])
    with pytest.raises(StoreError, match="disk is full"):
        writer.flush(20)
    with pytest.raises(StoreError, match="disk is full"):
        writer.stop(20)
    assert not writer.is_alive()
    Sick.cause = None
    Store.open(path).close()


def test_writer_start_refuses_what_can_never_work(path: Path) -> None:
    path.write_text("not a database")
    with pytest.raises(StoreError, match="not a deltak database"):
        StoreWriter(lambda: Store.open(path), [run_info()]).start()


def test_writer_starts_without_its_file_and_attaches_later(path: Path) -> None:
    there = threading.Event()

    def opener() -> Store:
        if not there.is_set():
            raise FULL
        return Store.open(path)

    writer = StoreWriter(opener, [run_info()], period_s=LONG)
    writer.start()
    writer.publish([batch(10)])
    assert not writer.flush(0.1)
    there.set()
    assert writer.flush(20)
    writer.stop(20)
    assert len(queries.estimates(path)) == 40


def test_writer_moves_its_progress_counter(make: Callable[..., StoreWriter]) -> None:
    writer = make()
    before = writer.progress
    assert writer.flush(20)
    assert writer.progress > before


def test_backlog_joins_small_batches_and_keeps_order() -> None:
    waiting = Backlog(10_000)
    for i in range(200):
        waiting.add([batch(1, first=i)], "disk full")
    taken = waiting.take()
    assert len(taken) < 70
    assert [int(t) for r in taken if isinstance(r, EstimateBatch) for t in r.t_ns] == [
        START + i * HOP for i in range(200)
    ]
    assert len(waiting) == 0


def test_backlog_never_drops_alarms() -> None:
    waiting = Backlog(4)
    waiting.add(
        [step("NORM", "UNACK"), batch(1), batch(1, first=1), step("UNACK", "RTNUN"), ledger()], "disk full"
    )
    kept = waiting.take()
    assert [type(r) for r in kept if not isinstance(r, EstimateBatch)][:2] == [
        AlarmTransition,
        AlarmTransition,
    ]
    assert waiting.dropped == {"disk full": 8}


def test_backlog_that_is_full_loses_its_oldest_instants_and_no_more() -> None:
    waiting = Backlog(1000)
    for i in range(400):
        waiting.add([batch(1, first=i)], "disk full")
    assert len(waiting) == 1000
    kept = [int(t) for r in waiting.take() if isinstance(r, EstimateBatch) for t in r.t_ns]
    assert kept == [START + i * HOP for i in range(150, 400)]
    assert waiting.dropped == {"disk full": 600}


def test_writer_whose_thread_fails_says_so_and_replays_do_not_take_that_for_success(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    Sick.cause = None
    writer = StoreWriter(lambda: Sick.open(path), [run_info()], lossless=True, period_s=LONG)
    writer.start()
    writer._thinners.clear()
    writer.publish([batch(1)])
    with pytest.raises(StoreError, match="KeyError"):
        writer.flush(20)
    with pytest.raises(StoreError, match="KeyError"):
        writer.stop(20)
    assert not writer.is_alive()
    assert [r.message for r in caplog.records if r.exc_info] == [
        f"{path}: the thread that writes to it failed"
    ]
    Store.open(path).close()


def test_writer_counts_what_is_left_and_closes_its_file_where_its_socket_cannot_be_removed(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Sick.cause = None
    writer = StoreWriter(lambda: Sick.open(path), [run_info()], period_s=LONG, served={})
    writer.start()
    Sick.cause = FULL
    monkeypatch.setattr("agent.storage.write.command_socket.CommandServer.stop", _read_only)
    writer.publish([batch(1)])
    writer.stop(20)
    Sick.cause = None
    assert writer.dropped.total() == 4
    Store.open(path).close()


def _read_only(_: object) -> None:
    raise OSError(errno.EROFS, "Read-only file system")


def test_pause_grows_to_five_seconds() -> None:
    pause = Pause()
    lengths = []
    for _ in range(8):
        pause.failed("disk full")
        lengths.append(pause.length_s)
    assert lengths == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0, 5.0]
    assert pause.passed()[0] == "disk full"
    assert pause.cause is None
