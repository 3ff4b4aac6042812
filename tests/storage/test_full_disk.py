"""A disk that fills up and is freed again, a real one: a small file system in memory."""

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from agent.storage.database.files import beside
from agent.storage.database.verify import problems
from agent.storage.read import queries
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests import peers
from tests.figures import figure
from tests.storage.rows import HOP, START, batch, run_info, select, step

SIZE = 24 * 1024 * 1024


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MiB."""
    mount = peers.program("mount", "mount")
    folder = tmp_path / "disk"
    folder.mkdir()
    done = subprocess.run(
        [mount, "-t", "tmpfs", "-o", f"size={SIZE}", "none", folder], capture_output=True, check=False
    )
    if done.returncode != 0:
        peers.missing(f"full disks: no file system can be mounted here ({done.stderr.decode().strip()})")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def fill(folder: Path) -> Path:
    """Write until not one byte more fits."""
    filler = folder / "filler"
    with filler.open("ab", buffering=0) as file:
        for size in (65536, 4096, 1):
            with suppress(OSError):
                while True:
                    file.write(bytes(size))
    return filler


def remount(folder: Path, how: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{how}", folder], check=True)


def wait_for(condition: object, deadline_s: float) -> float:
    """Wait until a condition holds; returns how long it took, s."""
    assert callable(condition)
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < deadline_s, "it did not happen in time"
        time.sleep(0.01)
    return time.monotonic() - start


@pytest.mark.parametrize("cycles", [5, pytest.param(20, marks=[pytest.mark.soak, pytest.mark.timeout(1200)])])
def test_full_disk_loses_nothing_acknowledged_and_resumes_alone(disk: Path, cycles: int) -> None:
    path = disk / "rig.db"
    remount(
        disk, f"size={SIZE * cycles // 5}"
    )  # rows of all cycles must fit, or the oldest give way to the newest
    writer = StoreWriter(lambda: Store.open(path, Retention()), [run_info()], period_s=0.05)
    writer.start()
    number = 0
    slowest = 0.0
    for _ in range(cycles):
        for _ in range(20):
            writer.publish([batch(5, first=5 * number)])
            number += 1
        assert writer.flush(20)
        filler = fill(disk)
        while writer.failing is None:
            writer.publish([batch(40, first=10**6 + 40 * number), step("NORM", "UNACK", START + number)])
            number += 1
            writer.flush(0.05)
            assert number < 3000, "the disk is not full"
        assert writer.is_alive()
        assert writer.failing in {"disk full", "input output error"}
        filler.unlink()
        begin = time.monotonic()
        assert writer.flush(10.0), f"no recovery in 10 s: {writer.failing}"
        slowest = max(slowest, time.monotonic() - begin)
    writer.stop(20)
    figure(
        f"full disk: {cycles} cycles, nothing acknowledged lost, recovery in {slowest:.1f} s at most (10 s)"
    )
    assert writer.dropped == {}
    assert slowest <= 10.0
    assert len(writer.run_ids) == 1
    assert (
        select(path, "SELECT count(*) FROM hops WHERE span = 0 AND t_ns < ?", START + 10**6 * HOP)[0][0]
        == cycles * 100
    )
    counted = select(path, "SELECT sum(count) FROM counters")[0][0] or 0
    assert writer.written == select(path, "SELECT (SELECT count(*) FROM estimates WHERE seq >> 10 IN (SELECT "
                                          "seq FROM hops WHERE span = 0)) + (SELECT count(*) FROM "
                                          "alarm_events) + (SELECT "
                                          "count(*) FROM events)")[0][0] + counted  # fmt: skip
    assert "disk full" in {e["cause"] for e in queries.events(path)}
    assert beside(path, ".ballast").exists()
    with Store.open(path) as store:
        assert store.recovery is None
        assert problems(store.connection) == []


def test_start_on_a_full_disk_makes_room_for_itself(disk: Path) -> None:
    path = disk / "rig.db"
    with Store.open(path) as store:
        run_id = store.begin_run(run_info())
        for i in range(20):
            store.write(run_id, [batch(400, first=400 * i, hop_ns=10**9)])
    fill(disk)
    writer = StoreWriter(lambda: Store.open(path), [run_info(started_ns=START + 1)], period_s=0.05)
    writer.start()
    writer.publish([batch(10, first=1_000_000)])
    assert writer.flush(20), f"it does not write: {writer.failing}"
    writer.stop(20)
    rows = queries.estimates(path, parameter="k1")
    assert [r["t_ns"] for r in rows[-10:]] == [START + (1_000_000 + i) * HOP for i in range(10)]
    assert os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize >= 0


@pytest.mark.realtime
def test_full_disk_that_stays_full_gives_the_place_of_the_oldest_hour_to_new_rows(disk: Path) -> None:
    """Rows come at a pace of their own: memory holds five seconds of them, and half of it is waited for."""
    path = disk / "rig.db"
    writer = StoreWriter(lambda: Store.open(path, Retention()), [run_info()], period_s=0.05, most_cells=8000)
    writer.start()
    for hour in range(5):
        writer.publish([batch(900, first=900 * hour, hop_ns=4 * 10**9)])
        assert writer.flush(20)
    fill(disk)
    number = 4500
    deadline = time.monotonic() + 30
    while (
        select(path, "SELECT min(t_ns) FROM hops WHERE span = 0")[0][0] == START
        and time.monotonic() < deadline
    ):
        writer.publish([batch(20, first=number, hop_ns=4 * 10**9)])
        number += 20
        writer.flush(0.05)
    assert writer.flush(20), writer.failing
    writer.stop(20)
    kept = select(path, "SELECT min(t_ns), max(t_ns) FROM hops WHERE span = 0")[0]
    assert kept[0] >= START + 3600 * 10**9
    assert kept[1] == START + (number - 1) * 4 * 10**9
    assert writer.dropped == {}


def test_first_start_on_a_full_disk_waits_for_room(disk: Path) -> None:
    path = disk / "rig.db"
    filler = fill(disk)
    writer = StoreWriter(lambda: Store.open(path), [run_info()], period_s=0.05)
    writer.start()
    writer.publish([batch(10)])
    assert not writer.flush(0.3)
    assert writer.failing == "disk full"
    filler.unlink()
    assert writer.flush(20)
    writer.stop(20)
    assert len(queries.estimates(path)) == 40


@pytest.mark.parametrize("there", [True, False], ids=["with a file", "first start"])
def test_start_on_a_read_only_disk_waits_and_says_so(disk: Path, there: bool) -> None:
    path = disk / "rig.db"
    if there:
        with Store.open(path) as store:
            store.write(store.begin_run(run_info()), [batch(10)])
    remount(disk, "ro")
    writer = StoreWriter(
        lambda: Store.open(path, Retention()), [run_info(started_ns=START + 1)], period_s=0.05
    )
    writer.start()
    writer.publish([batch(10, first=100), step("NORM", "UNACK", START + 100 * HOP)])
    assert not writer.flush(0.3)
    assert (writer.failing, writer.is_alive()) == ("read only", True)
    if there:
        assert len(queries.estimates(path)) == 40, "what is there must be read meanwhile"
    remount(disk, "rw")
    assert writer.flush(10), writer.failing
    writer.stop(20)
    assert writer.dropped == {}
    assert len(queries.estimates(path)) == (80 if there else 40)
    assert {a["parameter"]: a["state"] for a in queries.alarms(path)} == {"k1": "UNACK", "store": "RTNUN"}
    assert [e["cause"] for e in queries.events(path)] == ["read only"]
