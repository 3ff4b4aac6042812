"""Recordings on a disk that is full, a real one: they stop, are counted and told, and never cost a sample or
a row."""

import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from agent.recording import event_writer, recorder
from agent.recording.blocks import read_blocks
from agent.recording.recorder import Recorder
from drivers.port import SampleBlock
from tests import peers
from tests.recording.test_event_writer import Told, files, job, made
from tests.recording.test_recorder import HEADER, segments
from tests.replay.test_live_equals_replay import service
from tests.scenario.live import example, hops, rows, wait_until
from tests.sim.rigs import simulator
from tests.storage.test_full_disk import fill

MIB = 1024 * 1024


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 24 MiB."""
    mount = peers.program("mount", "mount")
    folder = tmp_path / "disk"
    folder.mkdir()
    command = [mount, "-t", "tmpfs", "-o", f"size={24 * MIB}", "none", folder]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode != 0:
        peers.missing(f"full disks: no file system can be mounted here ({done.stderr.decode().strip()})")
    yield folder
    subprocess.run(["umount", "-l", folder], check=True)


def block(number: int) -> SampleBlock:
    return SampleBlock(np.random.default_rng(number).normal(size=(2000, 3)), number)


def test_recorder_on_a_full_disk_goes_on_once_there_is_room_and_what_was_synced_stays(
    disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "room", lambda _: 1)
    monkeypatch.setattr(recorder, "FLUSH_S", 0.01)
    events: list[str] = []
    arrived = threading.Event()
    own = Recorder(disk, HEADER, tell=lambda cause, _: (events.append(cause), arrived.set())[-1])
    own.start()
    own.record(block(0))
    wait_until(lambda: own.recorded == 2000, "the first block")
    filler = fill(disk)
    own.record(block(1))
    assert arrived.wait(20)
    filler.unlink()
    own.record(block(2))
    own.stop(20)
    assert events == ["recording stopped", "recording resumed"]
    assert (own.recorded, own.dropped) == (4000, 2000)
    assert [b.arrival_ns for path in segments(disk) for b in read_blocks(path)] == [0, 2]


def test_event_record_on_a_full_disk_leaves_nothing_half_written(
    disk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(event_writer, "room", lambda _: 1)
    reported = Told()
    writer = made(disk, reported)
    (disk / "rig.db.events").mkdir()
    fill(disk)
    writer.start()
    writer.submit(job(writer.name("level", "k1")))
    reported.wait(lambda: bool(reported.rows()))
    writer.stop()
    assert [state for _, state in reported.rows()] == ["failed"]
    assert files(disk) == []


def test_agent_on_a_nearly_full_disk_estimates_and_alarms_on_and_records_nothing(
    disk: Path, tmp_path: Path
) -> None:
    example("modbus", tmp_path)
    text = (tmp_path / "modbus.toml").read_text(encoding="utf-8")
    text = text.replace('driver = "modbus"', 'driver = "modbus"\nrecord = true')
    fill(disk)
    with (disk / "filler").open("r+b") as file:
        file.truncate(22 * MIB)
    db = disk / "live.db"
    with (
        simulator(tmp_path, text, "--scenario", "default", "--fast") as device,
        service(device.config, db) as running,
    ):
        wait_until(lambda: hops(db) == 60, "60 rows")
        stopped = (
            "SELECT count(*) FROM v_events WHERE cause IN ('recording stopped', 'event records stopped')"
        )
        wait_until(lambda: rows(db, stopped)[0][0] == 2, "both to be told")
        assert all(writer.failing is None for writer in running.writers.values())
    states = rows(db, "SELECT DISTINCT state FROM v_event_records")
    assert states == [("failed",)]
    assert rows(db, "SELECT count(*) FROM v_alarms WHERE kind = 'level'") == [(6,)]
    assert rows(db, "SELECT received, used, dropped FROM v_health ORDER BY t_ns DESC LIMIT 1") == [
        (3000, 3000, 0)
    ]
    assert [path.name for path in disk.glob("*/*")] == []
