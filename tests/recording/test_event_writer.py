"""The files of event records: whole or not at all, within their bounds, never in the way of anything else."""

import errno
import json
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.config.sections.results import Events
from agent.recording import event_writer
from agent.recording.blocks import read_blocks, read_header
from agent.recording.event_files import EventFolder, Labels, Taken, read_meta
from agent.recording.event_writer import EventWriter, Facts, Job
from agent.records import EventRecord, HealthEvent, Record
from drivers.port import SampleBlock

START = 1_767_225_600_000_000_001
ONE = Facts("press-7", {"can": ("force", "x1")}, {"can": ("F", "X1")}, "ab" * 32, "0.1.0")
TWO = replace(ONE, channels={"can": ("force",), "plc": ("x1",)}, fields={"can": ("F",), "plc": ("X1",)})


class Told:
    """What a writer published, and a way to wait for it."""

    def __init__(self) -> None:
        self.records: list[Record] = []
        self._arrived = threading.Condition()

    def __call__(self, records: Sequence[Record]) -> None:
        with self._arrived:
            self.records += records
            self._arrived.notify_all()

    def wait(self, condition: Callable[[], bool]) -> None:
        with self._arrived:
            assert self._arrived.wait_for(condition, 20), self.records

    def rows(self) -> list[tuple[str, str]]:
        return [(Path(r.file).name, r.state) for r in self.records if isinstance(r, EventRecord)]

    def causes(self) -> list[str]:
        return [r.cause for r in self.records if isinstance(r, HealthEvent)]


@pytest.fixture
def reported() -> Told:
    return Told()


def made(
    folder: Path, reported: Told, facts: Facts = ONE, known: Sequence[EventRecord] = (), **limits: float | str
) -> EventWriter:
    return EventWriter(folder / "rig.db", facts, Events(**limits), reported, lambda: known)  # type: ignore[arg-type]


def job(name: str, state: str = "complete", samples: int = 500, source: str = "can", columns: int = 2) -> Job:
    number = np.arange(samples)
    values = np.random.default_rng(3).normal(size=(samples, columns))
    values[3, 0] = np.nan
    items = [Taken(source, SampleBlock(values, 5, number), number, np.ones(samples, np.bool_), samples - 1)]
    labels = [Labels(number, START + number * 1_000_000)]
    record = EventRecord("press-7", START, "level", "k1", 1, name, state, START, START, 0, 0, 4)  # type: ignore[arg-type]
    return Job(record, items, labels, (0, samples), {source: 65536})


def written(folder: Path, reported: Told, count: int, **limits: float | str) -> EventWriter:
    writer = made(folder, reported, **limits)
    writer.start()
    for _ in range(count):
        name = writer.name("level", "k1")
        writer.submit(job(name))
        reported.wait(lambda: any(Path(name).name == row for row, _ in reported.rows()))  # noqa: B023 - called at once
    writer.stop()
    return writer


def files(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "rig.db.events").iterdir() if path.suffix != ".ages")


def test_file_holds_time_stamps_readings_and_provenance(tmp_path: Path, reported: Told) -> None:
    written(tmp_path, reported, 1)
    sent = job("")
    with np.load(tmp_path / "rig.db.events" / "press-7-00000000-level-k1.npz", allow_pickle=False) as file:
        assert file["t"].dtype == "datetime64[ns]"
        np.testing.assert_array_equal(file["t"].astype(np.int64), sent.labels[0].t_ns)
        np.testing.assert_array_equal(file["force"], sent.items[0].block.values[:, 0])
        np.testing.assert_array_equal(file["x1"], sent.items[0].block.values[:, 1])
        np.testing.assert_array_equal(file["counter"], np.arange(500))
        meta = json.loads(str(file["meta"]))
    expected = {"config_sha256": "ab" * 32, "code_version": "0.1.0", "baseline_id": 4, "state": "complete",
                "kind": "level", "parameter": "k1", "rig": "press-7", "samples": 500}  # fmt: skip
    assert meta.items() >= expected.items()


def test_index_is_told_of_what_was_written(tmp_path: Path, reported: Told) -> None:
    written(tmp_path, reported, 1)
    (row,) = [r for r in reported.records if isinstance(r, EventRecord)]
    path = tmp_path / row.file
    assert (row.samples, row.from_ns, row.to_ns) == (500, START, START + 499_000_000)
    assert row.bytes == path.stat().st_size
    assert row.file == "rig.db.events/press-7-00000000-level-k1.npz"


def test_file_says_that_it_is_cut_until_it_is_complete(tmp_path: Path, reported: Told) -> None:
    writer = made(tmp_path, reported)
    name = writer.name("level", "k1")
    writer.start()
    for state, found in (("recording", "cut"), ("complete", "complete")):
        writer.submit(job(name, state))
        reported.wait(lambda: reported.rows()[-1:] == [(Path(name).name, state)])  # noqa: B023 - called at once
        assert read_meta(tmp_path / name)["state"] == found
    writer.stop()
    assert files(tmp_path) == ["press-7-00000000-level-k1.npz"]


def test_numbers_go_on_after_a_restart(tmp_path: Path, reported: Told) -> None:
    written(tmp_path, reported, 2)
    assert "00000002" in made(tmp_path, reported).name("sensor", "x1")


def test_rig_of_several_sources_keeps_a_raw_recording_of_each(tmp_path: Path, reported: Told) -> None:
    writer = made(tmp_path, reported, TWO)
    name = writer.name("level", "k1")
    both = job(name, columns=1)
    plc = replace(both.items[0]._asdict()["block"], arrival_ns=9)
    writer.start()
    writer.submit(replace(both, items=[*both.items, both.items[0]._replace(source="plc", block=plc)]))
    reported.wait(lambda: bool(reported.rows()))
    writer.stop()
    assert files(tmp_path) == ["press-7-00000000-level-k1.can.raw", "press-7-00000000-level-k1.plc.raw"]
    path = tmp_path / "rig.db.events" / "press-7-00000000-level-k1.plc.raw"
    with path.open("rb") as file:
        header = read_header(file, path)
    assert (header.source, header.fields, header.config_sha256) == ("plc", ("X1",), "ab" * 32)
    assert [block.arrival_ns for block in read_blocks(path)] == [9]


@pytest.mark.parametrize(
    ("limits", "left"), [({"max_count": 3}, 3), ({"max_mb": 0.02}, 1), ({"keep": "0.000000001s"}, 1)]
)
def test_oldest_records_go_first_and_the_index_says_so(
    tmp_path: Path, reported: Told, limits: dict[str, float | str], left: int
) -> None:
    written(tmp_path, reported, 6, **limits)
    assert [name[8:16] for name in files(tmp_path)] == [f"{n:08d}" for n in range(6 - left, 6)]
    gone = [name[8:16] for name, state in reported.rows() if state == "purged"]
    assert gone == [f"{n:08d}" for n in range(6 - left)]


@pytest.mark.parametrize("moment", [1.0, 4e9])
def test_records_made_by_a_wrong_clock_are_no_older(tmp_path: Path, reported: Told, moment: float) -> None:
    written(tmp_path, reported, 3, keep="1h")
    for name in files(tmp_path):
        os.utime(tmp_path / "rig.db.events" / name, (moment, moment))
    written(tmp_path, reported, 1, keep="1h")
    assert len(files(tmp_path)) == 4


def test_records_of_other_rigs_and_other_files_are_left_alone(tmp_path: Path, reported: Told) -> None:
    folder = tmp_path / "rig.db.events"
    folder.mkdir()
    others = [
        "press-00000000-level-k1.npz",
        "press-77-00000000-level-k1.npz",
        "notes.txt",
        "press-7-1-level-k1.npz",
    ]
    for name in others:
        (folder / name).write_bytes(b"x")
    written(tmp_path, reported, 3, max_count=1)
    assert set(files(tmp_path)) == {*others, "press-7-00000002-level-k1.npz"}


def test_full_disk_is_counted_and_told_once_and_records_go_on_after_it(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_self: EventFolder, _name: str, _content: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    writer = made(tmp_path, reported)
    writer.start()
    monkeypatch.setattr(EventFolder, "write", full)
    names = [writer.name("level", "k1") for _ in range(3)]
    for name in names[:2]:
        writer.submit(job(name))
    reported.wait(lambda: len(reported.rows()) == 2)
    monkeypatch.undo()
    writer.submit(job(names[2]))
    reported.wait(lambda: len(reported.rows()) == 3)
    writer.stop()
    assert [state for _, state in reported.rows()] == ["failed", "failed", "complete"]
    assert reported.causes() == ["event records stopped", "event records resumed"]
    assert writer.lost == 2
    (row,) = [r for r in reported.records if isinstance(r, EventRecord) and r.file == names[0]]
    assert row.message == "not all could be kept: No space left on device"


def test_full_disk_after_the_alarm_leaves_what_was_before_it(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = made(tmp_path, reported)
    name = writer.name("level", "k1")
    writer.start()
    writer.submit(job(name, "recording", samples=300))
    reported.wait(lambda: len(reported.rows()) == 1)
    monkeypatch.setattr(event_writer, "room", lambda _: 0)
    monkeypatch.setattr(EventWriter, "_delete", lambda *_: None)
    writer.submit(job(name, "complete"))
    reported.wait(lambda: len(reported.rows()) == 2)
    writer.stop()
    assert reported.rows()[-1] == (Path(name).name, "cut")
    meta = read_meta(tmp_path / name)
    assert (meta["state"], meta["samples"]) == ("cut", 300)


def test_nearly_full_disk_costs_the_oldest_records_first(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(tmp_path, reported, 3)
    monkeypatch.setattr(event_writer, "room", lambda _: 1 if len(files(tmp_path)) < 3 else 0)
    written(tmp_path, reported, 1)
    assert [name[8:16] for name in files(tmp_path)] == ["00000001", "00000002", "00000003"]


def test_slow_disk_costs_records_that_are_told_and_never_waits(tmp_path: Path, reported: Told) -> None:
    writer = made(tmp_path, reported)
    for number in range(event_writer.MOST_JOBS + 2):
        writer.submit(job(f"rig.db.events/press-7-{number:08d}-level-k1.npz"))
    assert writer.lost == 2
    assert [state for _, state in reported.rows()] == ["failed", "failed"]
    assert reported.causes() == ["event records stopped"]
    writer.start()
    writer.stop()
    assert len(files(tmp_path)) == event_writer.MOST_JOBS


def row(name: str, state: str) -> EventRecord:
    return replace(job(f"rig.db.events/{name}").record, state=state)  # type: ignore[arg-type]


def test_file_is_on_the_disk_before_it_has_its_name_and_its_name_before_it_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[str] = []
    sync, rename = os.fsync, Path.rename

    def synced(descriptor: int) -> None:
        done.append(f"sync {Path(f'/proc/self/fd/{descriptor}').readlink().name}")
        sync(descriptor)

    def renamed(self: Path, target: Path) -> Path:
        done.append(f"rename {target.name}")
        return rename(self, target)

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(Path, "rename", renamed)
    folder = EventFolder(tmp_path / "rig.db.events", "press-7")
    folder.write("one.npz", b"content")
    assert done[1:] == ["sync one.npz.part", "rename one.npz", "sync rig.db.events"]
    assert done[0] == f"sync {tmp_path.name}"


def test_restart_says_what_became_of_the_records_of_the_run_before(tmp_path: Path, reported: Told) -> None:
    written(tmp_path, reported, 3)
    reported.records.clear()
    (tmp_path / "rig.db.events" / "press-7-00000009-level-k1.npz.part").write_bytes(b"half")
    names = [f"press-7-0000000{n}-level-k1.npz" for n in range(6)]
    known = [
        row(names[0], "complete"),
        row(names[1], "recording"),
        row(names[4], "complete"),
        row(names[5], "failed"),
    ]
    writer = made(tmp_path, reported, known=known)
    writer.start()
    writer.stop()
    # one was being made, one was deleted by hand, and of one the power went before the index knew of it
    assert sorted(reported.rows()) == [(names[1], "cut"), (names[2], "complete"), (names[4], "purged")]
    assert files(tmp_path) == names[:3]


def test_restart_on_a_damaged_record_goes_on(tmp_path: Path, reported: Told) -> None:
    written(tmp_path, reported, 1)
    path = tmp_path / "rig.db.events" / "press-7-00000000-level-k1.npz"
    path.write_bytes(path.read_bytes()[:-100])
    (path.parent / "press-7-00000003-level-k1.npz").write_bytes(b"")
    np.savez(
        path.parent / "press-7-00000004-level-k1.npz", meta=np.array(json.dumps({"format": "DELTAKEVENT1"}))
    )
    reported.records.clear()
    written(tmp_path, reported, 1)
    assert reported.rows() == [("press-7-00000005-level-k1.npz", "complete")]


def test_channel_may_be_called_like_an_array_of_the_file(tmp_path: Path, reported: Told) -> None:
    writer = made(tmp_path, reported, replace(ONE, channels={"can": ("meta", "index")}))
    writer.start()
    name = writer.name("level", "k1")
    writer.submit(job(name))
    reported.wait(lambda: bool(reported.rows()))
    writer.stop()
    with np.load(tmp_path / name) as file:
        np.testing.assert_array_equal(file["meta"], job("").items[0].block.values[:, 0])
    assert read_meta(tmp_path / name)["parameter"] == "k1"


def test_record_of_a_source_that_never_came_is_an_empty_file_and_nothing_fails(
    tmp_path: Path, reported: Told
) -> None:
    writer = made(tmp_path, reported)
    writer.start()
    whole = job(writer.name("source", "can"))
    writer.submit(replace(whole, items=(), labels=()))
    reported.wait(lambda: bool(reported.rows()))
    writer.stop()
    (row,) = [r for r in reported.records if isinstance(r, EventRecord)]
    assert (row.state, row.samples, writer.lost) == ("complete", 0, 0)
    with np.load(tmp_path / row.file, allow_pickle=False) as file:
        assert file["force"].shape == file["t"].shape == (0,)
