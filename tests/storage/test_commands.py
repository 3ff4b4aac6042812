"""Commands that change a database: through its agent's socket while one runs, by themselves if none does."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.errors import StoreError, StoreHeldError
from agent.storage import maintenance
from agent.storage.database.files import beside
from agent.storage.read import queries
from agent.storage.write.command_socket import CommandServer, ask
from agent.storage.write.jobs import JobQueue
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import START, batch, run_info, select, step
from tests.storage.test_writer import FULL, Sick, error


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file with room to win: of ten hours of rows nine were purged."""
    path = tmp_path / "rig.db"
    with Store.open(path, Retention(full_s=3600.0)) as store:
        run_id = store.begin_run(run_info())
        for i in range(10):
            store.write(run_id, [batch(1000, first=1000 * i, hop_ns=36 * 10**8)])
            store.maintain()
    return path


@pytest.fixture
def agent(path: Path) -> Iterator[StoreWriter]:
    """What writes to the file and serves its socket, as in a running agent."""
    Sick.cause = None
    writer = StoreWriter(lambda: Sick.open(path), [run_info(started_ns=START + 1)], period_s=60.0, served={})
    writer.start()
    yield writer
    Sick.cause = None
    writer.stop()
    assert not beside(path, ".sock").exists()


def test_compact_of_a_file_that_an_agent_holds_is_done_by_the_agent(path: Path, agent: StoreWriter) -> None:
    agent.publish([batch(5, first=10**6)])
    assert agent.flush(20)
    shown = select(path, "SELECT count(*), sum(value) FROM v_estimates")
    before, after = maintenance.compact(path)
    assert 0 < after < 0.9 * before
    assert path.stat().st_size == after
    assert select(path, "SELECT count(*), sum(value) FROM v_estimates") == shown
    agent.publish([batch(5, first=2 * 10**6), step("NORM", "UNACK")])
    assert agent.flush(20)
    assert len(queries.alarms(path)) == 1


def test_compact_of_a_file_that_nobody_holds_takes_the_lock_itself(path: Path) -> None:
    before, after = maintenance.compact(path)
    assert after < 0.9 * before
    assert not beside(path, ".sock").exists()


def test_compact_counts_what_stood_in_the_log_only_among_the_bytes_before(
    path: Path, agent: StoreWriter
) -> None:
    maintenance.compact(path)
    agent.publish([batch(2000, first=3 * 10**6)])  # less than is moved into the file by itself
    assert agent.flush(20)
    before, after = maintenance.compact(path)
    assert after <= before
    assert maintenance.compact(path) == (after, after)


def test_compact_of_a_file_that_a_replay_holds_is_refused(path: Path) -> None:
    with Store.open(path):
        before = path.read_bytes()
        with pytest.raises(StoreHeldError, match="is writing to this database; stop it first"):
            maintenance.compact(path)
        assert path.read_bytes() == before


def test_repair_of_a_sound_file_that_an_agent_holds_changes_nothing(path: Path, agent: StoreWriter) -> None:
    assert maintenance.repair(path) is None
    assert agent.run_ids == {"press-7": 2}


def test_repair_of_a_damaged_file_that_an_agent_holds_goes_on_in_a_new_one(
    path: Path, agent: StoreWriter
) -> None:
    agent.publish([step("NORM", "UNACK"), batch(5, first=10**6)])
    assert agent.flush(20)
    agent._jobs.ask(lambda store: store.connection.execute("UPDATE alarms SET message = 'k1 rose'"))
    recovery = maintenance.repair(path)
    assert recovery is not None
    assert (recovery.aside.exists(), recovery.refused) == (True, 2)
    agent.publish([batch(5, first=2 * 10**6)])
    assert agent.flush(20)
    assert [a["parameter"] for a in queries.alarms(path)] == ["store"]
    assert maintenance.check(path).problems == []


def test_compact_while_the_disk_fails_says_so(path: Path, agent: StoreWriter) -> None:
    Sick.cause = FULL
    agent.publish([batch(1), step("NORM", "UNACK")])
    assert not agent.flush(0.3)
    with pytest.raises(StoreError, match=r"cannot write to it at present \(disk full\); look at its disk"):
        maintenance.compact(path)


def test_command_that_fails_is_told_and_the_agent_goes_on(path: Path, agent: StoreWriter) -> None:
    def fail(_: Store) -> None:
        raise error(13, "database or disk is full")

    with pytest.raises(Exception, match="database or disk is full"):
        agent._jobs.ask(fail)
    agent.publish([batch(1, first=10**6)])
    assert agent.flush(20)


def test_ask_of_an_agent_that_ends_is_answered(path: Path, agent: StoreWriter) -> None:
    agent.stop()
    with pytest.raises(StoreError, match="is ending"):
        agent._jobs.ask(lambda _: None)


def test_jobs_refused_tell_whoever_waits() -> None:
    jobs = JobQueue(lambda: None)
    answers: list[BaseException] = []

    def wait() -> None:
        with pytest.raises(StoreError) as caught:
            jobs.ask(lambda _: None)
        answers.append(caught.value)

    thread = threading.Thread(target=wait)
    thread.start()
    while not jobs:
        pass
    jobs.refuse("no", "later")
    thread.join(20)
    assert str(answers[0]) == "its agent: no; later"


def test_ask_waits_longer_than_its_patience_for_an_agent_that_is_at_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.storage.write.command_socket.LIFE_SIGN_S", 0.05)
    over = threading.Event()
    server = CommandServer(tmp_path / "rig.db", {"slow": lambda _: {"over": over.wait(1.0)}})
    server.start()
    threading.Timer(0.8, over.set).start()
    assert ask(tmp_path / "rig.db", "slow", timeout_s=0.4) == {"over": True}
    server.stop()
