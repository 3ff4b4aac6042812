"""Lines of slcan adapters: every letter, any byte, and each difference from python-can's parser explained."""

import re
from queue import SimpleQueue

import can
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus

from drivers.can.bus.bus import message_row
from drivers.can.bus.slcan_text import SlcanText
from drivers.can.codec.error_frames import names_of
from drivers.can.codec.frames import ERROR, FD_LENGTHS
from drivers.port import Counts

MS = 1_000_000


class Reading:
    def __init__(self, *, fd: bool = True) -> None:
        self.counts = Counts()
        self.text = SlcanText(self.counts, fd=fd)
        self.text.feed(b"\r", 0)

    def rows(self, data: bytes, arrival_ns: int = 0) -> list[bytes]:
        return [row.tobytes() for row in self.text.feed(data, arrival_ns).table]


class Library:
    """python-can's parser of single lines, without a line."""

    def __init__(self) -> None:
        self.bus = slcanBus.__new__(slcanBus)
        self.bus._queue = SimpleQueue()

    def row(self, line: bytes) -> bytes | None:
        """Return what the library makes of a line; None for no frame or an exception, which is the end of its
        bus."""
        try:
            self.bus._queue.put(line.decode())
            message, _ = self.bus._recv_internal(0.0)
        except (ValueError, IndexError):
            return None
        return None if message is None else message_row(message)


def text_of(message: can.Message) -> bytes:
    """Return the line that python-can writes of a message."""
    lines: list[str] = []
    bus = slcanBus.__new__(slcanBus)
    bus._write = lines.append  # type: ignore[method-assign]

    class Port:
        write_timeout = None

    bus.serialPortOrig = Port()
    bus.send(message)
    return lines[0].encode() + b"\r"


def message(rng: np.random.Generator) -> can.Message:
    extended, kind = bool(rng.integers(2)), rng.random()
    number = int(rng.integers(1 << (29 if extended else 11)))
    if kind < 0.1:
        return can.Message(0.0, number, extended, is_remote_frame=True, dlc=int(rng.integers(9)))
    fd = kind < 0.4
    size = int(rng.choice(FD_LENGTHS if fd else FD_LENGTHS[:9]))
    return can.Message(
        0.0, number, extended, is_fd=fd, bitrate_switch=fd and kind < 0.25, data=rng.bytes(size)
    )  # fmt: skip


def test_what_python_can_writes_of_every_kind_of_frame_is_read_in_any_pieces(
    rng: np.random.Generator,
) -> None:
    messages = [message(rng) for _ in range(500)]
    stream = b"".join(map(text_of, messages))
    cuts = sorted(rng.integers(0, len(stream), 300).tolist())
    reading = Reading()
    got = [
        row
        for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)
        for row in reading.rows(stream[a:b])
    ]
    assert got == [message_row(item) for item in messages]
    assert reading.counts.received == 0


@pytest.mark.parametrize("line", [b"", b"z", b"Z", b"V1013", b"v12", b"NA123", b"F00", b"sa000000"])
def test_answers_that_are_no_frame_are_known(line: bytes) -> None:
    reading = Reading()
    rows = reading.rows(line + b"\r")
    assert [names_of(row[0], row[9]) for row in rows] == ([["error-active"]] if line[:1] == b"s" else [])
    assert reading.counts == Counts()


@pytest.mark.parametrize(
    ("line", "names"),
    [
        (b"sb000000", ["bus-off"]),
        (b"sp128002", ["error-passive"]),
        (b"sw100000", ["error-warning"]),
        (b"e1a", ["no acknowledgement"]),
        (b"e3bcO", ["protocol error", "protocol error", "controller overflow"]),
        (b"F01", ["controller overflow"]),
        (b"F24", ["error-warning", "error-passive"]),
        (b"FC8", ["controller overflow", "arbitration lost", "bus error"]),
    ],
)
def test_states_and_errors_of_an_adapter_are_error_frames(line: bytes, names: list[str]) -> None:
    rows = Reading().rows(line + b"\r")
    assert all(int.from_bytes(row[:4], "little") & ERROR for row in rows)
    assert [name for row in rows for name in names_of(int.from_bytes(row[:4], "little"), row[9])] == names


def test_state_brings_the_controllers_counts_of_errors() -> None:
    (row,) = Reading().rows(b"sp128002\r")
    assert (row[14], row[15]) == (2, 128)


def test_bell_of_an_adapter_is_counted_as_a_refusal() -> None:
    reading = Reading()
    assert len(reading.rows(b"\at1000\r\a")) == 1
    assert reading.counts.faults == {"adapter refuses": 2}
    assert reading.counts.received == 0


@pytest.mark.parametrize(
    "line",
    [
        b"hello", b"\xff\xfe", b"\x00" * 8, b"t10", b"t100", b"t100211", b"t10021122 ", b"t1002112233",
        b"tFFF0",
        b"t100211223344F", b"T200000000", b"t10091122334455667788", b"t1002112G", b"t 100211", b"r1009",
        b"sp1280",
        b"r10021122AABBC", b"t1002-122", b"T1234567", b"d1239" + b"00" * 11, b"dFFF0", b"sx000000", b"e2a",
        b"e1x",
        b"F", b"FG1", b"t10021122EA60", b"V1", b"O", b"L",
    ],
)  # fmt: skip
def test_line_that_is_no_frame_is_counted_and_the_next_one_read(line: bytes) -> None:
    reading = Reading()
    assert len(reading.rows(line + b"\rt1002AABB\r")) == 1
    assert reading.counts.rejected == {"text": 1}
    assert reading.counts.received == 1


def test_line_that_was_under_way_when_the_port_was_opened_is_nobodys() -> None:
    counts = Counts()
    assert len(SlcanText(counts).feed(b"211AABB\rt1000\r", 0)) == 1
    assert counts == Counts()


@pytest.mark.parametrize("tail", [b"B000011100", b"d1230", b"b12301122", b"D1ABCDEF00"])
def test_end_of_a_broken_line_is_not_taken_for_an_fd_frame(tail: bytes) -> None:
    """The letters of FD frames are digits: a line whose beginning was lost can look like one."""
    assert SlcanText(Counts()).feed(tail + b"\r", 0).t_ns.tolist() == []
    broken, cut = Reading(), b"B00001111F" + b"0" * (127 - len(tail))
    assert broken.rows(cut + b"\r" + tail + b"\r") == []
    assert broken.rows(b"t1\r" + tail + b"\r") == []
    assert broken.counts.rejected == {"text": 4}
    assert (
        len(broken.rows(cut + b"00\r" + tail + b"\r")) == 1
    )  # too long together: the first was broken by itself
    assert Reading(fd=False).rows(b"t1000\r" + tail + b"\r") == Reading().rows(b"t1000\r")


def test_line_that_never_ends_is_not_kept() -> None:
    reading = Reading()
    for _ in range(1000):
        reading.rows(b"\xfe" * 1000)
        assert len(reading.text._rest) <= 160
    assert len(reading.rows(b"t1000\rt1000\r")) == 1
    assert reading.counts.rejected == {"text": 1}


@pytest.mark.parametrize("count", [20_000, pytest.param(10_000_000, marks=pytest.mark.soak)])
def test_mutated_lines_are_read_as_python_can_reads_them_or_rejected_for_a_reason(
    rng: np.random.Generator, count: int
) -> None:
    reading, library = Reading(), Library()
    good = read = lines = 0
    base = [text_of(message(rng)) for _ in range(500)]
    whole_lines = set(base)
    while lines < count:
        picked = [base[i] for i in rng.integers(0, len(base), 500).tolist()]
        stream = bytearray(b"".join(picked))
        for place in rng.integers(0, len(stream), 150).tolist():
            stream[place] = (
                int(rng.integers(256)) if rng.random() < 0.5 else int(rng.choice(list(b"tTrRdDbB09AFz\r\a")))
            )
        whole = True
        for line, end in re.findall(rb"([^\r\a]*)([\r\a])", bytes(stream)):
            lines += 1
            mine = reading.rows(line + end)
            agree(line, end, mine, library.row(line), whole)
            whole = bool(mine) or understood(line, end)
            good += line + end in whole_lines
            read += line + end in whole_lines and len(mine)
        reading.text.feed(b"\r", 0)
    assert 0.5 * lines < good < 0.9 * lines
    assert read >= 0.99 * good


STRICT = re.compile(
    rb"([trdb][0-7][0-9A-Fa-f]{2}|[TRDBx][01][0-9A-Fa-f]{7})([0-9A-Fa-f])((?:[0-9A-Fa-f]{2})*?)([0-9A-Fa-f]{4})?"
)
KNOWN = re.compile(rb"|[zZ]|V[0-9A-Fa-f]{4}|v[0-9A-Fa-f]{1,4}|N[0-9A-Za-z]{4}|F[0-9A-Fa-f]{2}|s[awpb]\d{6}")
ERRORS = re.compile(rb"e([1-9])([abBcfoOs]+)")


def understood(line: bytes, end: bytes) -> bool:
    errors = ERRORS.fullmatch(line)
    if errors is not None and end == b"\r":
        return len(errors[2]) == int(errors[1])
    return (end == b"\r" and bool(KNOWN.fullmatch(line))) or (end == b"\a" and not line)


def by_the_book(line: bytes) -> bool:
    """Tell whether a line is a frame to the letter of the protocol: exactly as many digits as its length asks
    for."""
    match = STRICT.fullmatch(line)
    if match is None:
        return False
    code = int(match[2], 16)
    if code > 8 and line[:1] not in b"dDbB":
        return False
    digits = 0 if line[:1] in b"rR" else 2 * FD_LENGTHS[code]
    behind = line[len(match[1]) + 1 + digits :]
    enough = len(line) >= len(match[1]) + 1 + digits
    return enough and (not behind or (len(behind) == 4 and int(behind, 16) < 60_000))


def agree(line: bytes, end: bytes, mine: list[bytes], theirs: bytes | None, after_whole: bool) -> None:
    """Hold two readings of a line against each other; what differs must have one of these reasons."""
    if end == b"\a":
        assert not mine  # a bell ends no frame
    elif by_the_book(line) and line[:1] in b"dDbB" and not after_whole:
        assert mine in (
            [],
            [theirs],
        )  # it begins in a digit: perhaps it is the end of the broken line before it
    elif line[:1] in (b"s", b"e", b"F"):
        assert theirs is None  # states and errors, which the library does not know
    elif by_the_book(line):
        assert mine == [theirs]
    else:
        assert (
            not mine
        )  # signs, spaces, missing and surplus digits, impossible numbers: the library takes some of them


def test_stamps_of_the_adapter_wrap_every_minute_and_follow_it() -> None:
    reading = Reading()
    frames = reading.text.feed(b"t1000EA5F\rt10000000\rt10000001\rt1002AABB0002\r", 5 * MS)
    assert frames.t_ns.tolist() == [5 * MS, 6 * MS, 7 * MS, 8 * MS]
    assert frames.table["length"].tolist() == [0, 0, 0, 2]


def test_stamps_over_a_silence_of_minutes_count_the_wraps_by_the_time_of_arrival() -> None:
    reading = Reading()
    first = reading.text.feed(b"t1000000A\r", 0).t_ns[0]
    later = reading.text.feed(b"t1000000B\r", 3 * 60_000 * MS + 20 * MS).t_ns[0]
    assert later - first == 3 * 60_000 * MS + MS


def test_frames_without_stamp_have_the_time_of_arrival() -> None:
    assert Reading().text.feed(b"t1000\rt1000\r", 77).t_ns.tolist() == [77, 77]
