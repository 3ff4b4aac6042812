import errno
import json
import os
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from agent.errors import RecordingError
from agent.recording import folder as folders
from agent.recording.blocks import decode_block, encode_block, read_blocks, read_header
from agent.recording.header import RawHeader
from agent.recording.recorder import Limits, Recorder, segments_of
from drivers.port import SampleBlock

HEADER = RawHeader(
    "can", ("F", "X1", "X2"), 65536, "ab" * 32, "0.1.0", 1_767_225_600_000_000_000, rig="press-7"
)


def block(number: int, rows: int = 50, counter: bool = True, times: bool = False) -> SampleBlock:
    rng = np.random.default_rng(number)
    values = rng.normal(size=(rows, 3))
    values[0, 1] = np.nan
    index = np.arange(number * rows, (number + 1) * rows)
    return SampleBlock(
        values, 10**9 + number, index % 65536 if counter else None, 10**6 * index if times else None
    )


def same(one: SampleBlock, two: SampleBlock) -> bool:
    def equal(a: object, b: object) -> bool:
        return (a is None) == (b is None) and (
            a is None or np.asarray(a).tobytes() == np.asarray(b).tobytes()
        )

    return one.arrival_ns == two.arrival_ns and all(
        equal(getattr(one, n), getattr(two, n)) for n in ("values", "counter", "t_ns")
    )


def segments(folder: Path, header: RawHeader = HEADER) -> list[Path]:
    return segments_of(folder, header, None, Limits()).files()


def recorded(
    folder: Path, blocks: list[SampleBlock], limits: Limits | None = None, **options: object
) -> Recorder:
    recorder = Recorder(folder, HEADER, None, limits, **options)  # type: ignore[arg-type]
    recorder.start()
    for one in blocks:
        recorder.record(one)
    recorder.stop(20)
    return recorder


@pytest.mark.parametrize(("counter", "times"), [(True, True), (True, False), (False, True), (False, False)])
def test_block_comes_back_to_the_last_bit(counter: bool, times: bool) -> None:
    sent = block(3, counter=counter, times=times)
    assert same(decode_block(encode_block(sent)[8:]), sent)


def test_recording_is_replayable_byte_for_byte(tmp_path: Path) -> None:
    sent = [block(i, rows=1 + i % 7) for i in range(200)]
    recorder = recorded(tmp_path, sent)
    (path,) = segments(tmp_path)
    got = list(read_blocks(path))
    assert len(got) == 200
    assert all(same(a, b) for a, b in zip(sent, got, strict=True))
    assert (recorder.recorded, recorder.dropped) == (sum(map(len, sent)), 0)
    with path.open("rb") as file:
        assert read_header(file, path) == HEADER


def test_recording_goes_on_in_a_new_segment_after_a_restart(tmp_path: Path) -> None:
    recorded(tmp_path, [block(0)])
    recorded(tmp_path, [block(1)])
    assert [p.name for p in segments(tmp_path)] == ["press-7-can-00000000.raw", "press-7-can-00000001.raw"]


def test_recordings_of_sources_with_like_names_do_not_touch_each_other(tmp_path: Path) -> None:
    for name in ("can", "can-1", "can-2"):
        own = Recorder(
            tmp_path, RawHeader(name, ("F",), None, "", "", 0, rig="press-7"), None, Limits(max_bytes=1)
        )
        own.start()
        own.record(block(0))
        own.stop(20)
    assert [p.name for p in segments(tmp_path)] == ["press-7-can-00000000.raw"]
    assert len(list(tmp_path.iterdir())) == 3


def test_recording_is_bounded_by_size_and_keeps_the_newest(tmp_path: Path) -> None:
    limits = Limits(60_000, segment_bytes=10_000)
    for i in range(10):
        recorded(tmp_path, [block(10 * i + j, rows=100) for j in range(10)], limits)
    there = segments(tmp_path)
    assert sum(p.stat().st_size for p in there) <= 60_000 + 20_000
    assert same(list(read_blocks(there[-1]))[-1], block(99, rows=100))


def test_recording_is_bounded_by_age(tmp_path: Path) -> None:
    recorded(tmp_path, [block(i) for i in range(10)], Limits(max_age_s=0, segment_bytes=100))
    assert len(segments(tmp_path)) <= 1


def test_age_of_files_of_an_earlier_process_counts_as_well(tmp_path: Path) -> None:
    for i in range(3):
        recorded(tmp_path, [block(i)], Limits(max_age_s=86400.0))
    (ages,) = tmp_path.glob("*.ages")
    content = json.loads(ages.read_text())
    first, *_ = sorted(content["ended"])
    later = {name: ended + 86_500.0 * (name != first) for name, ended in content["ended"].items()}
    ages.write_text(json.dumps({"ran_s": content["ran_s"] + 86_500.0, "ended": later}))
    recorded(tmp_path, [block(3)], Limits(max_age_s=86400.0))
    assert [p.name[-12:] for p in segments(tmp_path)] == ["00000001.raw", "00000002.raw", "00000003.raw"]


@pytest.mark.parametrize("moment", [1.0, 1e9, 4e9])
def test_recording_made_by_a_wrong_clock_is_no_older(tmp_path: Path, moment: float) -> None:
    for i in range(2):
        recorded(tmp_path, [block(i)], Limits(max_age_s=3600.0))
    for path in segments(tmp_path):
        os.utime(path, (moment, moment))
    recorded(tmp_path, [block(2)], Limits(max_age_s=3600.0))
    assert len(segments(tmp_path)) == 3


@pytest.mark.parametrize(
    "content", ["", "[]", '{"ran_s": -5}', '{"ran_s": 9, "ended": {"x": NaN}}', '{"ran_s": "q"}']
)
def test_ages_that_cannot_be_read_delete_nothing(tmp_path: Path, content: str) -> None:
    recorded(tmp_path, [block(0)], Limits(max_age_s=3600.0))
    (ages,) = tmp_path.glob("*.ages")
    ages.write_text(content)
    recorded(tmp_path, [block(1)], Limits(max_age_s=3600.0))
    assert len(segments(tmp_path)) == 2


@pytest.mark.parametrize("cut", [1, 7, 8, 100, 1000])
def test_segment_cut_short_is_read_up_to_its_last_whole_block(tmp_path: Path, cut: int) -> None:
    sent = [block(i) for i in range(5)]
    recorded(tmp_path, sent)
    (path,) = segments(tmp_path)
    path.write_bytes(path.read_bytes()[:-cut])
    got = list(read_blocks(path))
    assert len(got) == 4
    assert all(same(a, b) for a, b in zip(sent, got, strict=False))


def test_segment_with_a_flipped_bit_ends_before_it(tmp_path: Path) -> None:
    recorded(tmp_path, [block(i) for i in range(5)])
    (path,) = segments(tmp_path)
    octets = bytearray(path.read_bytes())
    octets[-2000] ^= 4
    path.write_bytes(octets)
    assert len(list(read_blocks(path))) < 5


@pytest.mark.parametrize("content", [b"", b"t,force\n", b"DELTAKRAW1\n", b"DELTAKRAW1\n\x05\x00\x00\x00{]}"])
def test_file_that_is_no_recording_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.raw"
    path.write_bytes(content)
    with pytest.raises(RecordingError) as caught:
        list(read_blocks(path))
    assert caught.value.exit_code == 2


class Told:
    """What a recorder told, and a way to wait for it."""

    def __init__(self) -> None:
        self.events: list[tuple[str, str]] = []
        self.arrived = threading.Condition()

    def __call__(self, cause: str, words: str) -> None:
        with self.arrived:
            self.events.append((cause, words))
            self.arrived.notify_all()

    def wait(self, count: int) -> None:
        with self.arrived:
            assert self.arrived.wait_for(lambda: len(self.events) >= count, 20), self.events


@pytest.fixture
def reported() -> Told:
    return Told()


def no_space(_path: object, _header: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_failing_disk_costs_samples_that_are_counted_and_told_once_and_the_next_are_recorded(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path, HEADER, tell=reported)
    monkeypatch.setattr("agent.recording.blocks.BlockSegment", no_space)
    for one in ([block(0), block(1)], [block(2)]):
        recorder._write([(b, None) for b in one])
    monkeypatch.undo()
    recorder._write([(block(3), None)])
    recorder._write([(block(4), None)])
    recorder._abandon()
    assert (recorder.dropped, recorder.recorded) == (150, 100)
    assert [cause for cause, _ in reported.events] == ["recording stopped", "recording resumed"]
    assert reported.events[0][1] == "can: cannot be recorded: No space left on device"
    assert [b.arrival_ns for b in read_blocks(segments(tmp_path)[0])] == [10**9 + 3, 10**9 + 4]


def test_after_a_failed_sync_recording_goes_on_in_a_new_file(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path, HEADER, tell=reported)
    recorder._write([(block(0), None)])

    def failing(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("agent.recording.blocks.os.fdatasync", failing)
    recorder._write([(block(1), None)])
    monkeypatch.undo()
    recorder._write([(block(2), None)])
    recorder._abandon()
    assert len(segments(tmp_path)) == 2
    assert [b.arrival_ns for b in read_blocks(segments(tmp_path)[1])] == [10**9 + 2]
    assert (recorder.recorded, recorder.dropped) == (100, 50)


def test_samples_that_are_on_the_disk_count_as_recorded_where_old_files_cannot_be_deleted(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path, HEADER, limits=Limits(max_bytes=1, segment_bytes=1), tell=reported)

    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refuse)
    for one in range(3):
        recorder._write([(block(one), None)])
    monkeypatch.undo()
    recorder._abandon()
    assert (recorder.recorded, recorder.dropped) == (150, 0)
    assert len(segments(tmp_path)) == 3


def disk_with(monkeypatch: pytest.MonkeyPatch, free: Callable[[], int]) -> None:
    monkeypatch.setattr("agent.recording.recorder.room", lambda _: free())


def test_nearly_full_disk_costs_the_oldest_recordings_first_and_is_left_to_the_database(
    tmp_path: Path, reported: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    for i in range(3):
        recorded(tmp_path, [block(i)])
    disk_with(monkeypatch, lambda: 1 if len(segments(tmp_path)) < 3 else 0)
    recorder = recorded(tmp_path, [block(3)], tell=reported)
    assert [p.name[-12:-4] for p in segments(tmp_path)] == ["00000001", "00000002", "00000003"]
    disk_with(monkeypatch, lambda: 0)
    recorder = recorded(tmp_path, [block(4)], tell=reported)
    assert segments(tmp_path) == []
    assert (recorder.recorded, recorder.dropped) == (0, 50)
    assert reported.events == [
        (
            "recording stopped",
            "can: cannot be recorded: the disk is nearly full; what is left is the database's",
        )
    ]


def test_room_leaves_a_tenth_of_a_small_disk_and_64_mib_of_a_large_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def disk(blocks: int, free: int) -> int:
        facts = os.statvfs_result((4096, 4096, blocks, free, free, 0, 0, 0, 0, 255))
        monkeypatch.setattr(folders.os, "statvfs", lambda _: facts)
        return folders.room(tmp_path)

    assert disk(1000, 500) == 4096 * 400
    assert disk(1000, 50) == -4096 * 50
    assert disk(10_000_000, 16_384) == 0


def test_recorder_writes_and_syncs_no_more_often_than_once_a_period(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[int] = []
    monkeypatch.setattr("agent.recording.blocks.os.fdatasync", synced.append)
    monkeypatch.setattr("agent.recording.recorder.FLUSH_S", 60.0)
    recorder = recorded(tmp_path, [block(i) for i in range(500)])
    assert recorder.recorded == 25_000
    assert len(synced) == 1


def test_recorder_never_blocks_and_counts_and_tells_what_does_not_fit(tmp_path: Path, reported: Told) -> None:
    recorder = Recorder(tmp_path, HEADER, most=3, tell=reported)
    for i in range(10):
        recorder.record(block(i))
    assert recorder.dropped == 350
    recorder.start()
    recorder.stop(20)
    assert recorder.recorded == 150
    assert reported.events == [
        ("recording resumed", "can: recorded again; 350 samples were not (the disk was too slow)")
    ]
