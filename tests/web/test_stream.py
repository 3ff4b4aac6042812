"""Events: every commit once and in order, whatever is cut; slow listeners and a killed server touch no
database."""

import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from agent.cli.web.stream import Position, is_settled, stamp
from agent.storage.read.recent import Cursor
from agent.storage.write.store import Store
from tests.storage.rows import HOP, batch, run_info, step
from tests.web import files
from tests.web.server import Client, serving

pytestmark = pytest.mark.realtime


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return files.make(tmp_path_factory.mktemp("streamed"))


@pytest.fixture(scope="module")
def client(path: Path) -> Iterator[Client]:
    with serving("--db", path) as client:
        yield client


def test_planted_alarm_comes_within_two_seconds_of_its_commit(client: Client, path: Path) -> None:
    with client.events() as events:
        assert next(events)[1] == "hello"
        started = time.monotonic()
        files.plant(path)
        _, kind, document = next(events)
        assert time.monotonic() - started < 2.0
    assert (kind, document["to_state"], document["alarm"]["message"], document["db"]) == (
        "alarm", "UNACK", "k2 planted", "rig",
    )  # fmt: skip


def test_stream_cut_fifty_times_has_no_gap_and_no_double(client: Client, path: Path) -> None:
    with client.events() as events:
        since = next(events)[0]
    start = time.time_ns()
    seen: list[int] = []
    steps = 0
    with Store.open(path) as store:
        run = store.begin_run(run_info(started_ns=start))
        for cut in range(50):
            store.write(
                run,
                [
                    batch(3, first=3 * cut, start=start),
                    step("NORM", "UNACK", start + cut, parameter=f"p{cut}"),
                ],
            )
            with client.events(since) as events:
                wanted = 1 + cut % 4  # none of the cuts falls where a commit ends
                for identifier, kind, document in events:
                    since = identifier
                    steps += kind == "alarm"
                    seen += [document["t_ns"]] if kind == "estimates" else []
                    wanted -= kind != "hello"
                    if not wanted:
                        break
        with client.events(since) as events:
            while len(seen) < 150 or steps < 50:
                _, kind, document = next(events)
                steps += kind == "alarm"
                seen += [document["t_ns"]] if kind == "estimates" else []
    assert seen == [start + i * HOP for i in range(150)]
    assert steps == 50


def test_position_that_cannot_be_resumed_begins_anew(client: Client) -> None:
    for said in ("nonsense", "1.2~3.4", "999999.999999", "9999999999999999999999.1"):
        with client.events(said) as events:
            identifier, kind, _ = next(events)
        assert kind == "reset"
        assert Position.read(identifier, 1) is not None


def test_stamp_is_settled_once_a_later_commit_must_change_it(path: Path) -> None:
    os.utime(path)
    assert not is_settled(stamp(path))
    hour_ago = time.time() - 3600
    for file in (path, path.with_name("rig.db-wal")):
        if file.exists():
            os.utime(file, (hour_ago, hour_ago))
    assert is_settled(stamp(path))


def test_position_is_read_as_it_is_written() -> None:
    position = Position((Cursor(1, 2), Cursor(3, 4)))
    assert Position.read(str(position), 2) == position
    assert Position.read(str(position), 1) is None


def test_killed_server_and_slow_listeners_cost_the_database_nothing(memory: Path) -> None:
    path = files.make(memory)
    start = time.time_ns()
    with serving("--db", path) as client, Store.open(path) as store:
        run = store.begin_run(run_info(started_ns=start))
        slow = [socket.create_connection(("127.0.0.1", client.port)) for _ in range(100)]
        for place, peer in enumerate(
            slow
        ):  # half of them never end their request, half never read the answer
            peer.sendall(
                b"GET /api/v1/events HTTP/1.1\r\nHost: localhost\r\n" + (b"\r\n" if place % 2 else b"")
            )
        for turn in range(10):
            before = time.monotonic()
            store.write(run, [batch(50, first=50 * turn, start=start)])
            assert time.monotonic() - before < 1.0
            assert store.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0
        assert len(client.get("latest")["rows"]) == 6
        os.kill(client.pid, signal.SIGKILL)
        store.write(run, [batch(50, first=500, start=start)])
        assert store.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0] == 0
        for peer in slow:
            peer.close()
    with serving("--db", path) as client:
        assert len(client.get("estimates?rig=press-7&parameter=k1&since=600s")["rows"]) == 100 + 550
