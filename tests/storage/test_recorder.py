import errno
import io
from pathlib import Path

import numpy as np
import pytest

from agent.errors import RecordingError
from agent.runtime.recorder import RawHeader, Recorder, decode_block, encode_block, read_blocks, read_header, segments
from drivers.port import SampleBlock

HEADER = RawHeader("can", ("F", "X1", "X2"), 65536, "ab" * 32, "0.1.0", 1_767_225_600_000_000_000)


def block(number: int, rows: int = 50, counter: bool = True, times: bool = False) -> SampleBlock:
    rng = np.random.default_rng(number)
    values = rng.normal(size=(rows, 3))
    values[0, 1] = np.nan
    index = np.arange(number * rows, (number + 1) * rows)
    return SampleBlock(values, 10**9 + number, index % 65536 if counter else None, 10**6 * index if times else None)


def same(one: SampleBlock, two: SampleBlock) -> bool:
    def equal(a: object, b: object) -> bool:
        return (a is None) == (b is None) and (a is None or np.asarray(a).tobytes() == np.asarray(b).tobytes())

    return one.arrival_ns == two.arrival_ns and all(
        equal(getattr(one, n), getattr(two, n)) for n in ("values", "counter", "t_ns")
    )


def recorded(folder: Path, blocks: list[SampleBlock], **options: int) -> Recorder:
    recorder = Recorder(folder, HEADER, **options)
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
    (path,) = segments(tmp_path, "can")
    got = list(read_blocks(path))
    assert len(got) == 200
    assert all(same(a, b) for a, b in zip(sent, got, strict=True))
    assert (recorder.recorded, recorder.dropped) == (sum(map(len, sent)), 0)
    with path.open("rb") as file:
        assert read_header(file, path) == HEADER


def test_recording_goes_on_in_a_new_segment_after_a_restart(tmp_path: Path) -> None:
    recorded(tmp_path, [block(0)])
    recorded(tmp_path, [block(1)])
    assert [p.name for p in segments(tmp_path, "can")] == ["can-00000000.raw", "can-00000001.raw"]


def test_recording_is_bounded_by_size(tmp_path: Path) -> None:
    for i in range(10):
        recorded(tmp_path, [block(10 * i + j, rows=100) for j in range(10)], segment_bytes=10_000, max_bytes=60_000)
    there = segments(tmp_path, "can")
    assert sum(p.stat().st_size for p in there) <= 60_000 + 20_000
    assert same(list(read_blocks(there[-1]))[-1], block(99, rows=100))


def test_recording_is_bounded_by_age(tmp_path: Path) -> None:
    recorded(tmp_path, [block(i) for i in range(10)], segment_bytes=100, max_age_s=0)
    assert len(segments(tmp_path, "can")) <= 1


@pytest.mark.parametrize("cut", [1, 7, 8, 100, 1000])
def test_segment_cut_short_is_read_up_to_its_last_whole_block(tmp_path: Path, cut: int) -> None:
    sent = [block(i) for i in range(5)]
    recorded(tmp_path, sent)
    (path,) = segments(tmp_path, "can")
    path.write_bytes(path.read_bytes()[:-cut])
    got = list(read_blocks(path))
    assert len(got) == 4
    assert all(same(a, b) for a, b in zip(sent, got, strict=False))


def test_segment_with_a_flipped_bit_ends_before_it(tmp_path: Path) -> None:
    recorded(tmp_path, [block(i) for i in range(5)])
    (path,) = segments(tmp_path, "can")
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


def test_recorder_counts_what_a_failing_disk_costs_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.BytesIO):
        name = str(tmp_path / "full")

        def write(self, _: object) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    recorder = Recorder(tmp_path, HEADER)
    monkeypatch.setattr(recorder, "_segment", Full)
    recorder._write([block(0), block(1)])
    monkeypatch.undo()
    recorder._write([block(2)])
    assert (recorder.dropped, recorder.recorded) == (100, 50)
    recorder._close()


def test_recorder_never_blocks_and_counts_what_does_not_fit(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, HEADER, most_blocks=3)
    for i in range(10):
        recorder.record(block(i))
    assert recorder.dropped == 350
    recorder.start()
    recorder.stop(20)
    assert recorder.recorded == 150
