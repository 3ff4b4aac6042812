from collections.abc import Iterator

import numpy as np
import pytest

from drivers.modbus.frames import FIFO, ReplyError, Request, RtuFrames, TcpFrames
from tests.conformance.modbus_device import crc16

READ = Request(1, 4, 0x0300, 2)


def rtu(text: str) -> bytes:
    body = bytes.fromhex(text)
    return body + crc16(body)


@pytest.mark.parametrize(
    ("request_", "wire"),
    [
        (Request(1, 3, 0x0300, 2), "01 03 03 00 00 02 C4 4F"),
        (Request(1, 3, 0x0100, 2), "01 03 01 00 00 02 C5 F7"),
        (Request(17, FIFO, 0x04DE), rtu("11 18 04 DE").hex()),
    ],
)
def test_rtu_request_has_the_bytes_of_the_books(request_: Request, wire: str) -> None:
    assert RtuFrames().request(request_) == bytes.fromhex(wire)


def test_rtu_replies_of_a_load_cell_read_what_it_showed() -> None:
    data = RtuFrames().reply(bytes.fromhex("01 03 04 00 00 03 A7 BB 79"), Request(1, 3, 0x0300, 2))
    assert data is not None
    assert data.view(">i4")[0] == 935
    data = RtuFrames().reply(bytes.fromhex("01 03 04 42 BB 00 00 9E 6E"), Request(1, 3, 0x0100, 2))
    assert data is not None
    assert data.view(">f4")[0] == 93.5


def test_tcp_request_has_the_bytes_of_the_books() -> None:
    assert TcpFrames().request(READ) == bytes.fromhex("00 01 00 00 00 06 01 04 03 00 00 02")


FIFO_REPLY = "18 00 06 00 02 01 B8 12 84"


def test_fifo_reply_over_both_wires_gives_its_registers() -> None:
    request = Request(17, FIFO, 0x04DE)
    frames = TcpFrames()
    frames.request(request)
    over_tcp = frames.reply(bytes.fromhex("00 01 00 00 00 0A 11" + FIFO_REPLY), request)
    over_rtu = RtuFrames().reply(rtu("11" + FIFO_REPLY), request)
    for data in (over_tcp, over_rtu):
        assert data is not None
        assert data.view(">u2").tolist() == [0x01B8, 0x1284]


def test_fifo_reply_of_31_registers_over_rtu_is_read_whole() -> None:
    body = "01 18 00 40 00 1F" + "AB CD" * 31
    data = RtuFrames().reply(rtu(body), Request(1, FIFO, 7))
    assert data is not None
    assert len(data) == 62


@pytest.mark.parametrize(
    "reply", ["18 00 06 00 03 01 B8 12 84", "18 00 08 00 02 01 B8 12 84", "18 00 42 00 20" + "00" * 64]
)
def test_fifo_reply_whose_counts_disagree_is_refused(reply: str) -> None:
    frames = TcpFrames()
    frames.request(Request(17, FIFO, 1))
    size = len(bytes.fromhex(reply)) + 1
    with pytest.raises(ReplyError, match="disagree"):
        frames.reply(bytes.fromhex(f"00 01 00 00 {size:04X} 11" + reply), Request(17, FIFO, 1))


@pytest.mark.parametrize("unit", [1, 2, 3, 4, 5, 17, 100])
def test_rtu_reply_behind_any_stray_byte_is_found(unit: int) -> None:
    # ids that look like function codes are those at which the library's framer gives up
    reply = rtu(f"{unit:02X} 04 04 00 00 03 A7")
    for stray in range(256):
        data = RtuFrames().reply(bytes([stray]) + reply, Request(unit, 4, 0, 2))
        assert data is not None, (unit, stray)
        assert data.view(">i4")[0] == 935


def test_rtu_reply_behind_a_cut_one_and_an_echo_is_found() -> None:
    reply = rtu("01 04 04 00 00 03 A7")
    frames = RtuFrames()
    for before in (reply[:-3], frames.request(READ), bytes(9)):
        assert frames.reply(before, READ) is None
        assert frames.late == ()
        data = frames.reply(before + reply, READ)
        assert data is not None
        assert data.view(">i4")[0] == 935


def tcp_reply(transaction: int, value: int) -> bytes:
    return bytes.fromhex(f"{transaction:04X} 00 00 00 07 01 04 04 {value:08X}")


def given_up() -> TcpFrames:
    """Frames that have given request 1 up and wait for the answer to request 2."""
    frames = TcpFrames()
    frames.request(READ)
    frames.give_up()
    frames.request(READ)
    return frames


@pytest.mark.parametrize("order", [(1, 2), (2, 1), (1, 2, 1)])
def test_tcp_reply_is_found_before_and_behind_those_given_up(order: tuple[int, ...]) -> None:
    frames = given_up()
    data = frames.reply(b"".join(tcp_reply(number, number) for number in order), READ)
    assert data is not None
    assert data.view(">i4")[0] == 2
    assert frames.late == (1,) * (len(order) - 1)


def test_tcp_reply_given_up_is_waited_for_until_it_is_whole() -> None:
    frames = given_up()
    late = tcp_reply(1, 7)
    for cut in range(1, len(late)):
        assert frames.reply(late[:cut], READ) is None
        assert frames.partial(late[:cut])
    assert frames.reply(late, READ) is None
    assert not frames.partial(late)
    assert frames.late == (1,)


def test_tcp_reply_given_up_on_another_connection_is_a_fault() -> None:
    frames = given_up()
    frames.restart()
    with pytest.raises(ReplyError, match="a reply of transaction 1 to 2"):
        frames.reply(tcp_reply(1, 7), READ)


def test_rtu_exception_is_raised_in_words() -> None:
    with pytest.raises(
        ReplyError, match=r"exception 2 \(illegal data address\) to function 4, unit 1, registers 768"
    ):
        RtuFrames().reply(rtu("01 84 02"), READ)


def tcp_answer(data: bytes) -> bytes | None:
    frames = TcpFrames()
    frames.request(READ)
    try:
        answer = frames.reply(data, READ)
    except ReplyError:
        return None
    return None if answer is None else answer.tobytes()


def rtu_answer(data: bytes) -> bytes | None:
    try:
        answer = RtuFrames().reply(data, READ)
    except ReplyError:
        return None
    return None if answer is None else answer.tobytes()


MANY = [5_000, pytest.param(10_000_000, marks=[pytest.mark.soak, pytest.mark.timeout(7200)])]
TABLE = [int.from_bytes(crc16(bytes([byte])), "little") ^ 0x40BF for byte in range(256)]
"""What each byte does to an empty CRC register: the checksum of that byte, less that of a zero."""


def quick_crc16(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ TABLE[(crc ^ byte) & 255]
    return crc


def mutations(rng: np.random.Generator, good: bytes, count: int) -> Iterator[bytes]:
    """Yield frames with one to three bytes flipped, put in or taken out."""
    for number in range(count):
        if number % 1000 == 0:
            draws = rng.integers((0, 0, 0), (4, 1 << 16, 256), (1000, 3, 3)).tolist()
            times = rng.integers(1, 4, 1000).tolist()
        data = bytearray(good)
        for kind, place, value in draws[number % 1000][: times[number % 1000]]:
            if kind == 0:
                data.insert(place % (len(data) + 1), value)
            elif kind == 1:
                del data[place % len(data)]
            else:
                data[place % len(data)] ^= 1 << value % 8
        yield bytes(data)


def test_quick_checksum_is_the_one_bit_by_bit(rng: np.random.Generator) -> None:
    for _ in range(100):
        data = rng.integers(0, 256, 9, np.uint8).tobytes()
        assert quick_crc16(data).to_bytes(2, "little") == crc16(data)


@pytest.mark.parametrize("count", MANY)
def test_tcp_reply_mutated_is_refused_or_differs_in_its_data_only(
    rng: np.random.Generator, count: int
) -> None:
    good = bytes.fromhex("00 01 00 00 00 07 01 04 04 00 00 03 A7")
    for data in mutations(rng, good, count):
        sound = data[:9] == good[:9] and len(data) == len(good)
        assert tcp_answer(data) == (data[9:] if sound else None), data.hex(" ")


@pytest.mark.parametrize("count", MANY)
def test_rtu_reply_mutated_is_refused_or_holds_a_frame_with_a_good_checksum(
    rng: np.random.Generator, count: int
) -> None:
    good = rtu("01 04 04 00 00 03 A7")
    for data in mutations(rng, good, count):
        frames = [data[i : i + 9] for i in range(len(data) - 8) if data[i : i + 3] == good[:3]]
        sound = [
            frame[3:7] for frame in frames if quick_crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
        ]
        assert rtu_answer(data) == (sound[0] if sound else None), data.hex(" ")
