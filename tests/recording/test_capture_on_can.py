"""What is recorded of a CAN bus is candump's own text: independent programs read it, and it makes the same
samples."""

import json
import re
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from agent.errors import RecordingError
from agent.recording import capture
from agent.recording.header import RawHeader
from agent.recording.recorder import Limits, Recorder, segments_of
from agent.recording.source import is_own
from drivers.can.codec.capture import Keeper, candump_text, captured_frames, interface_name
from drivers.can.codec.frames import (
    ERROR,
    EXTENDED,
    FD_FLAG,
    REMOTE,
    Frames,
    candump_frames,
    frames_of,
    pack_frame,
)
from drivers.port import Capture, DriverConfigError, SampleBlock
from tests import peers

START = 1_767_225_600_123_456_789
HEADER = RawHeader("can", ("M.A",), 256, "ab" * 32, "0.1.0", START, rig="press-7")


def every_kind() -> Frames:
    """One frame of each kind that the notation knows."""
    rows = [
        pack_frame(0x123, bytes(range(8))),
        pack_frame(0x7FF, b""),
        pack_frame(0x18FEF100 | EXTENDED, b"\xff" * 8),
        pack_frame(0x321, b"\x01\x02\x03", FD_FLAG),
        pack_frame(0x322, bytes(range(64)), FD_FLAG | 0x01),
        pack_frame(0x1ABCDEF | EXTENDED, bytes(12), FD_FLAG | 0x03),
        pack_frame(0x100 | REMOTE, b"", 0, 4),
        pack_frame(0x101 | REMOTE, b""),
        pack_frame(0x80 | ERROR, bytes(8)),
    ]
    return frames_of(rows, START + np.arange(len(rows), dtype=np.int64) * 1_000_001)


def random_frames(count: int, seed: int = 3) -> Frames:
    rng = np.random.default_rng(seed)
    rows = [pack_frame(int(rng.integers(0x800)), rng.bytes(int(rng.integers(9)))) for _ in range(count)]
    return frames_of(rows, START + np.cumsum(rng.integers(1, 10**6, count)))


def kept(pieces: Sequence[Frames], **counts: Any) -> list[Capture]:
    keeper, found = Keeper("vcan0"), []
    for frames in pieces:
        keeper.add(frames, counts.get("dropped", {}), counts.get("text", 0), counts.get("reopened", 0))
        piece = keeper.take()
        assert piece is not None
        found.append(piece)
    return found


def recorded(folder: Path, pieces: Sequence[Capture]) -> Path:
    recorder = Recorder(folder, HEADER, ".log")
    recorder.start()
    for number, piece in enumerate(pieces):
        values = np.zeros((piece.lines, 1))
        recorder.record(SampleBlock(values, 10**9 + number, None, None, 0, 5), piece)
    recorder.stop(20)
    (path,) = segments_of(folder, HEADER, ".log", Limits()).files()
    return path


def test_text_is_the_notation_of_can_utils() -> None:
    lines = candump_text(every_kind(), "can0").decode().splitlines()
    assert [line.split(" ", 2)[2] for line in lines] == [
        "123#0001020304050607",
        "7FF#",
        "18FEF100#FFFFFFFFFFFFFFFF",
        "321##0010203",
        "322##1" + bytes(range(64)).hex().upper(),
        "01ABCDEF##3" + "00" * 12,
        "100#R4",
        "101#R",
        "20000080#" + "00" * 8,
    ]
    assert lines[0].startswith("(1767225600.123456) can0 ")


def test_text_is_read_back_as_the_same_frames() -> None:
    sent = every_kind()
    (piece,) = kept([sent])
    got = captured_frames(piece.text(), piece.beside)
    np.testing.assert_array_equal(got.t_ns, sent.t_ns)
    for name in ("id", "length", "data"):
        np.testing.assert_array_equal(got.table[name], sent.table[name])


def test_time_stamps_of_whole_microseconds_need_nothing_beside() -> None:
    frames = random_frames(5)
    (piece,) = kept([Frames(frames.table, frames.t_ns // 1000 * 1000)])
    assert piece.beside == {}


def test_python_can_reads_every_kind(tmp_path: Path) -> None:
    path = recorded(tmp_path, kept([every_kind()]))
    with can.CanutilsLogReader(path) as reader:
        got = list(reader)
    assert [m.arbitration_id for m in got[:8]] == [
        0x123,
        0x7FF,
        0x18FEF100,
        0x321,
        0x322,
        0x1ABCDEF,
        0x100,
        0x101,
    ]
    assert [m.is_fd for m in got[:8]] == [False] * 3 + [True] * 3 + [False] * 2
    assert [m.is_extended_id for m in got[:8]] == [False, False, True, False, False, True, False, False]
    assert [m.is_remote_frame for m in got[:8]] == [False] * 6 + [True, True]
    assert got[8].is_error_frame
    assert [bytes(m.data) for m in got[:6]] == [
        bytes(range(8)), b"", b"\xff" * 8, b"\x01\x02\x03", bytes(range(64)), bytes(12),
    ]  # fmt: skip
    assert (got[4].bitrate_switch, got[4].error_state_indicator, got[5].error_state_indicator) == (
        True,
        False,
        True,
    )
    assert got[0].timestamp == pytest.approx(START / 1e9, abs=1e-6)
    assert {m.channel for m in got[:8]} == {"vcan0"}


def test_can_utils_turn_it_into_vectors_form_and_back_without_loss(tmp_path: Path) -> None:
    there, back = peers.program("log2asc", "can-utils"), peers.program("asc2log", "can-utils")
    frames = random_frames(500)
    path = recorded(tmp_path, kept([frames]))
    subprocess.run([there, "-I", path, "-O", tmp_path / "a.asc", "vcan0"], check=True, timeout=20)
    subprocess.run([back, "-I", tmp_path / "a.asc", "-O", tmp_path / "b.log"], check=True, timeout=20)
    got, bad = candump_frames((tmp_path / "b.log").read_text(encoding="ascii").splitlines())
    assert bad == []
    np.testing.assert_array_equal(got.table, frames.table)
    # the other form counts from its first frame, in microseconds
    assert np.abs(np.diff(got.t_ns) - np.diff(frames.t_ns)).max() <= 1000


def test_log2asc_turns_every_frame_into_vectors_form(tmp_path: Path) -> None:
    tool = peers.program("log2asc", "can-utils")
    frames = every_kind()
    path = recorded(tmp_path, kept([frames]))
    target = tmp_path / "out.asc"
    subprocess.run([tool, "-I", path, "-O", target, "vcan0"], check=True, capture_output=True, timeout=20)
    lines = [
        line for line in target.read_text(encoding="ascii").splitlines() if re.match(r"\s*\d+\.\d+ ", line)
    ]
    assert len(lines) == len(frames)
    assert "18FEF100x" in lines[2]


def test_pieces_come_back_byte_for_byte_with_their_times(tmp_path: Path) -> None:
    sent = kept([random_frames(1 + i % 9, seed=i) for i in range(100)], dropped={"kernel queue": 3})
    path = recorded(tmp_path, sent)
    got = list(capture.read_pieces(path))
    assert [piece.text for piece in got] == [piece.text() for piece in sent]
    assert [piece.beside for piece in got] == [dict(piece.beside) for piece in sent]
    assert [piece.arrival_ns for piece in got] == [10**9 + i for i in range(100)]
    assert {piece.wall_offset_ns for piece in got} == {5}
    assert capture.read_header(path) == HEADER
    assert is_own(path)


def test_what_the_bus_lost_is_kept_as_it_grows() -> None:
    keeper = Keeper("can0")
    keeper.add(random_frames(1), {"kernel queue": 3}, 0, 0)
    first = keeper.take()
    keeper.add(random_frames(1), {"kernel queue": 5}, 2, 1)
    second = keeper.take()
    assert first is not None
    assert second is not None
    assert first.beside["dropped"] == {"kernel queue": 3}
    assert {k: second.beside[k] for k in ("dropped", "text", "reopened")} == {
        "dropped": {"kernel queue": 2}, "text": 2, "reopened": 1,
    }  # fmt: skip
    assert keeper.take() is None
    keeper.add(Frames(random_frames(1).table, np.array([START // 1000 * 1000])), {"kernel queue": 5}, 2, 1)
    third = keeper.take()
    assert third is not None
    assert third.beside == {}


def short_index(path: Path) -> None:
    index = capture.index_of(path)
    index.write_bytes(index.read_bytes()[:-3])


def short_log(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-3])


def flipped(path: Path) -> None:
    octets = bytearray(path.read_bytes())
    octets[-5] ^= 1
    path.write_bytes(octets)


@pytest.mark.parametrize("damage", [short_index, short_log, flipped])
def test_damaged_recording_is_read_up_to_its_last_whole_piece(tmp_path: Path, damage: Any) -> None:
    sent = kept([random_frames(4, seed=i) for i in range(5)])
    path = recorded(tmp_path, sent)
    damage(path)
    assert [piece.text for piece in capture.read_pieces(path)] == [piece.text() for piece in sent[:4]]


@pytest.mark.parametrize("line", ["", "{}", "[]", '{"format": "DELTAKHEARD9"}', "(1.0) can0 1#"])
def test_index_that_is_none_is_refused(tmp_path: Path, line: str) -> None:
    path = recorded(tmp_path, kept([random_frames(4)]))
    capture.index_of(path).write_text(line, encoding="utf-8")
    with pytest.raises(RecordingError) as caught:
        capture.read_header(path)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("beside", [{"finer": "AA"}, {"finer": "é"}, {"finer": 3}, {"finer": "AAAAAAAA"}])
def test_times_beside_that_make_no_sense_are_an_error(beside: dict[str, Any]) -> None:
    text = candump_text(random_frames(2), "can0")
    with pytest.raises(DriverConfigError, match="beside"):
        captured_frames(text, beside)


def test_text_that_is_no_frame_is_an_error() -> None:
    with pytest.raises(DriverConfigError, match="no frame"):
        captured_frames(b"(1.0) can0 12#\n", {})


@pytest.mark.parametrize(
    ("channel", "name"),
    [("can0", "can0"), ("/dev/ttyACM0@115200", "ttyACM0_115200"), ("", "can"), ("ä b", "__b")],
)
def test_interface_names_are_such_that_tools_take_them(channel: str, name: str) -> None:
    assert interface_name(channel) == name


def test_index_is_lines_of_json_that_anybody_reads(tmp_path: Path) -> None:
    path = recorded(tmp_path, kept([random_frames(4)]))
    header, piece = map(json.loads, capture.index_of(path).read_text(encoding="utf-8").splitlines())
    assert (header["format"], header["rig"], header["byte_order"]) == ("DELTAKHEARD1", "press-7", "little")
    assert piece["lines"] == 4
