"""Candump text read by the table: line for line what one line at a time, and python-can, read."""

import io

import can
import numpy as np
import pytest

from drivers.can.bus.bus import message_row
from drivers.can.codec.frames import FRAME, candump_row
from drivers.can.log.text import candump_block
from tests import peers


def line(rng: np.random.Generator) -> str:
    """A line as candump or python-can writes: any bus, both identifiers, every length, FD, remote, error."""
    seconds = f"{rng.integers(9 * 10 ** int(rng.integers(10)))}.{rng.integers(10**6):06d}"
    number = f"{rng.integers(1 << 29):08X}" if rng.random() < 0.4 else f"{rng.integers(1 << 11):03X}"
    kind, size = rng.random(), int(rng.choice([8, 8, 8, *range(8)]))
    data = rng.bytes(size).hex()
    body = f"#{data.upper() if rng.random() < 0.7 else data}"
    if kind < 0.2:
        body = f"##{rng.integers(10)}{rng.bytes(int(rng.choice([0, 7, 8, 12, 16, 64]))).hex()}"
    elif kind < 0.25:
        body = f"#R{rng.choice(['', '0', '8'])}"
    elif kind < 0.28:
        number, body = "20000080", "#0000000000000000"
    bus = rng.choice(["can0", "vcan0", "c", "can_of_the_press"])
    return f"({seconds}) {bus} {number}{body}{rng.choice(['', ' R', ' T'])}"


def text(lines: list[str]) -> bytes:
    return "".join(f"{item}\n" for item in lines).encode("latin-1")


def one_by_one(lines: list[str]) -> tuple[list[bytes], list[int], list[int]]:
    items = [candump_row(item) for item in lines]
    bad = [place for place, item in enumerate(items) if item is None and lines[place].strip()]
    return [item[1] for item in items if item], [item[0] for item in items if item], bad


def check(lines: list[str]) -> None:
    frames, bad = candump_block(text(lines))
    rows, times, wrong = one_by_one(lines)
    assert [row.tobytes() for row in frames.table] == rows
    assert frames.t_ns.tolist() == times
    assert bad == wrong


def test_many_lines_of_every_kind_are_read_as_one_line_is(rng: np.random.Generator) -> None:
    check([line(rng) for _ in range(20_000)])


def test_whole_lines_are_read_as_python_can_reads_them(rng: np.random.Generator) -> None:
    lines = [line(rng) for _ in range(5_000)]
    frames, bad = candump_block(text(lines))
    assert not bad
    expected = [message_row(message) for message in can.CanutilsLogReader(io.StringIO(text(lines).decode()))]
    known = [
        (place, row) for place, row in enumerate(expected) if not row[3] & 0x20
    ]  # of an error frame the library keeps nothing but that it is one
    assert len(known) > 4_500
    assert [without_flags(frames.table[place].tobytes()) for place, _ in known] == [
        without_flags(row) for _, row in known
    ]
    times = [message.timestamp for message in can.CanutilsLogReader(io.StringIO(text(lines).decode()))]
    np.testing.assert_allclose(frames.t_ns / 1e9, times, rtol=1e-15, atol=1e-6)


def without_flags(row: bytes) -> bytes:
    return row[:5] + bytes([row[5] & 4]) + row[6:]


@pytest.mark.parametrize("count", [20_000, pytest.param(10_000_000, marks=pytest.mark.soak)])
def test_mutated_lines_are_read_as_one_line_is_or_told_as_bad(rng: np.random.Generator, count: int) -> None:
    for _ in range(count // 5_000):
        lines = [line(rng) for _ in range(500)] * 10
        stream = bytearray(text(lines))
        for place in rng.integers(0, len(stream), 2_000).tolist():
            stream[place] = int(rng.integers(256))
        check(bytes(stream).decode("latin-1").replace("\r", "\x00").split("\n"))


@pytest.mark.parametrize(
    "content",
    [b"", b"\n", b"\n\n\n", b"(", b"()", b"#\n" * 30, b")#\n" * 30, b"(1.5) can0 123#" + b"\n", b"\xff" * 300,
     b"(1.5) can0 123#11\r\n" * 20, b"(1.) can0 123#11\n" * 20, b"(.5) can0 123#11\n" * 20,
     b"(1.5) can0 FFF#11\n" * 20, b"(1.5) can0 F0000000#11\n" * 20, b"(1.5)  can0  123#11\n" * 20,
     b"(1.5) can0 123#1\n" * 20, b"(1.5) can0 123##\n" * 20, b"(1.5) can0 123##1\n" * 20,
     b"(1.5)   123#11\n" * 20,
     b"(1.5) 123#11\n" * 20, b"(1.5) x 123#11\n" * 20, b"(12345678901234.5) x 123#11\n" * 20,
     b"(9999999999.0) x 123#11\n" * 20,
     b"(1.5) can0 123#11 X\n" * 20, b"(1.5) can0 123#11 R", b"(1.5) can0 20000040#0000000000000000\n" * 20],
    ids=lambda content: repr(content[:24]),
)  # fmt: skip
def test_odd_text_is_read_as_one_line_is(content: bytes) -> None:
    lines = content.decode("latin-1").split("\n")
    frames, bad = candump_block(content)
    rows, times, wrong = one_by_one(lines)
    assert [row.tobytes() for row in frames.table] == rows
    assert (frames.t_ns.tolist(), bad) == (times, wrong)
    assert frames.table.dtype == FRAME


def test_real_truck_log_by_the_table_is_what_one_line_at_a_time_gives() -> None:
    check(peers.data("can/j1939_2F6913DB.log").read_text().splitlines()[:30_000])


@pytest.mark.parametrize("end", ["\n", ""])
@pytest.mark.parametrize("wrong", [None, 1, 12, 27, 33, 41])
def test_lines_all_of_one_shape_are_read_as_one_line_is(end: str, wrong: int | None) -> None:
    """Nothing lies between them; one that has a character amiss is left out, and leaves nothing behind."""
    lines = [f"({1600000000 + i}.{i:06d}) can0 12{i % 16:X}#{i:04X}{65535 - i:012X}" for i in range(40)]
    if wrong is not None:
        lines[7] = lines[7][:wrong] + "x" + lines[7][wrong + 1 :]
    frames, bad = candump_block(("\n".join(lines) + end).encode())
    rows, times, amiss = one_by_one(lines)
    assert bad == amiss
    assert frames.table.tobytes() == b"".join(rows)
    assert frames.t_ns.tolist() == times


@pytest.mark.parametrize("wire", ["can0", "vcan0", "c", "can_of_the_press", "can"])
def test_frames_of_one_interface_are_those_of_its_lines(wire: str, rng: np.random.Generator) -> None:
    lines = [line(rng) for _ in range(5_000)] + ["rubbish", "(1.5)   can0  123#01", "(1.5) can0 123#0"]
    rng.shuffle(lines)
    frames, bad = candump_block(text(lines), wire.encode())
    mine = [item for item in lines if item.split()[1:2] == [wire]]
    rows, times, _ = one_by_one(mine)
    assert [row.tobytes() for row in frames.table] == rows
    assert frames.t_ns.tolist() == times
    assert bad == candump_block(text(lines))[1]
