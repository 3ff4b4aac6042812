from pathlib import Path

import can
import pytest
from can.interfaces.socketcand.socketcand import convert_ascii_message_to_can_message

from drivers.can.bus.bus import message_row
from drivers.can.codec.frames import DaemonText, candump_frames, candump_row

LINES = [
    b"< frame 123 23.424242 11223344 >",
    b"< frame 1ABCDEF0 1600000000.000001  >",
    b"< frame 7FF 0.1 0102030405060708 >",
    b"< error 20 12.5 >",
    b"< frame 100 5.000000 " + b"AB" * 64 + b" >",
]


def test_daemon_text_in_any_pieces_gives_the_frames_that_the_library_gives() -> None:
    stream = b"".join(LINES)
    expected = [
        message_row(convert_ascii_message_to_can_message(line.decode())) for line in LINES[:1] + LINES[2:3]
    ]
    for split in range(len(stream)):
        text = DaemonText()
        rows = [row.tobytes() for part in (stream[:split], stream[split:]) for row in text.feed(part).table]
        assert len(rows) == 5
        assert [rows[0], rows[2]] == expected
        assert text.bad == 0


@pytest.mark.parametrize(
    ("line", "identifier"),
    [
        (b"< error 040 1.5 >", 0x40),
        (b"< error 20000004 1.5 >", 4),
        (b"< error 20 12.5 >", 0x20),
        (b"< error could not open bus >", 0),
    ],
)
def test_error_that_the_daemon_passes_on_keeps_its_class(line: bytes, identifier: int) -> None:
    assert DaemonText().feed(line).table["id"].tolist() == [0x20000000 | identifier]


@pytest.mark.parametrize("line", [b"< frame 123 9999999999.0 11 >", b"(9999999999.0) can0 123#11"])
def test_time_stamp_that_no_clock_shows_makes_no_frame(line: bytes) -> None:
    assert len(DaemonText().feed(line)) == 0
    assert candump_row(line.decode()) is None


def test_remote_frame_that_the_daemon_passes_on_is_one() -> None:
    text = DaemonText()
    frames = text.feed(b"< rtr 123 23.424242 8 >< rtr 1ABCDEF0 1.5 0 >< frame 123 24.000000 11 >")
    assert frames.table["id"].tolist() == [0x40000123, 0xC0000000 | 0x1ABCDEF0, 0x123]
    assert frames.table["length"].tolist() == [8, 0, 1]
    assert frames.t_ns.tolist() == [23_424242000, 1_500000000, 24_000000000]
    assert text.bad == 0
    for line in (
        b"< rtr 123 23.4 9 >",
        b"< rtr FFF 23.4 8 >",
        b"< rtr 123 9999999999.0 8 >",
        b"< rtr 123 8 >",
    ):
        assert len(text.feed(line)) == 0
    assert text.bad == 4


def test_daemon_text_times_are_exact_nanoseconds() -> None:
    frames = DaemonText().feed(b"< frame 001 1700000000.123456789 00 >< frame 001 0.5 00 >")
    assert frames.t_ns.tolist() == [1700000000123456789, 500000000]


@pytest.mark.parametrize(
    "line",
    [
        b"< frame 123 1.0 1 >", b"< frame XYZ 1.0 11 >", b"< frame FFF 1.0 11 >",
        b"< frame 3FFFFFFF 1.0 11 >",
        b"< frame 001 1.0 " + b"00" * 9 + b" >", b"< frame 001 -1.0 00 >", b"frame 1 1.0 00 >",
        b"< nonsense >",
        b"< frame 1 1.0 00 >",
        b"< frame 123 1.0 \xff\xfe >",
    ],
)  # fmt: skip
def test_daemon_message_that_is_no_frame_is_counted_and_the_next_one_read(line: bytes) -> None:
    text = DaemonText()
    assert len(text.feed(line + LINES[0])) == 1
    assert text.bad == 1


def test_candump_lines_of_every_kind_are_read_as_the_library_reads_them(tmp_path: Path) -> None:
    lines = [
        "(1641469561.006950) can0 7BB#10356101FFFFF3CC",
        "(0.000001) vcan1 1ABCDEF0#",
        "(5.5) can0 123#R",
        "(5.5) can0 123#R4",
        "(5.5) can0 123##1AABBCC",
        "(5.5) can0 123#11 T",
    ]
    frames, bad = candump_frames(lines)
    assert not bad
    path = tmp_path / "a.log"
    path.write_text("\n".join(lines) + "\n")
    with can.LogReader(path) as reader:
        expected = [message_row(message) for message in reader]
    assert [row.tobytes() for row in frames.table[:3]] == expected[:3]
    assert [bytes(row["data"][:3]) for row in frames.table[4:]] == [b"\xaa\xbb\xcc", b"\x11\0\0"]
    assert frames.t_ns[0] == 1641469561006950000


@pytest.mark.parametrize(
    "line",
    [
        "",
        "hello",
        "(1.0) can0 123",
        "(1.0) can0 123#1",
        "(1.0) can0 123#" + "00" * 9,
        "(1.0) can0 12#00",
        "(x) a 123#00",
    ],
)
def test_candump_line_that_is_no_frame_is_refused(line: str) -> None:
    assert candump_row(line) is None
