"""Real Modbus/TCP traffic, fed as bytes to the same code that reads the wire: nothing malformed is taken for
data."""

import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.modbus.frames import ReplyError, Request, RtuFrames, TcpFrames
from tests import figures, peers
from tests.pcap import segments

CAPTURES = ["modbus_test_2.pcap", "MODBUS-TestDataPart1.pcap", "fuzz-1011.pcap", "fuzz-72.pcap"]
PORT = 502
Way = tuple[tuple[str, int], tuple[str, int]]


def capture(name: str) -> Path:
    return peers.data(f"modbus/{name}")


def packets(path: Path) -> Iterator[tuple[bool, Way, bytes]]:
    """Yield what each packet carried, if it went to the device, and the connection seen from the reader."""
    for segment in segments(path):
        asks = segment.target[1] == PORT
        way = (segment.source, segment.target) if asks else (segment.target, segment.source)
        if segment.data and PORT in {segment.source[1], segment.target[1]}:
            yield asks, way, segment.data


def asked(data: bytes) -> tuple[int, Request] | None:
    """Read a request for registers by the standard; None for any other packet."""
    if len(data) != 12 or data[2:6] != b"\0\0\0\6" or data[7] not in {3, 4}:
        return None
    number, unit, function, address, count = struct.unpack(">H4xBBHH", data)
    return number, Request(unit, function, address, count)


def exchanges(path: Path) -> Iterator[tuple[int, Request, bytes]]:
    """Yield each packet of a device with the request of its transaction, on the same connection."""
    waiting: dict[tuple[Way, int], Request] = {}
    for asks, way, data in packets(path):
        if asks and (request := asked(data)):
            waiting[way, request[0]] = request[1]
        elif not asks and (way, number := int.from_bytes(data[:2], "big")) in waiting:
            yield number, waiting[way, number], data


def by_the_standard(number: int, request: Request, data: bytes) -> bytes | None:
    """Return the registers when the bytes are exactly one good reply: the oracle, written from the
    specification."""
    size = 2 * request.count
    head = struct.pack(">HHHBBB", number, 0, size + 3, request.unit, request.function, size % 256)
    return data[9:] if data[:9] == head and len(data) == 9 + size else None


def taken(number: int, request: Request, data: bytes) -> bytes | None:
    frames = TcpFrames()
    frames._transaction = number
    try:
        answer = frames.reply(data, request)
    except ReplyError:
        return None
    return None if answer is None else answer.tobytes()


def test_replies_of_a_real_device_are_all_read_as_it_meant_them() -> None:
    path = capture("modbus_test_2.pcap")
    requests = [request for asks, _, data in packets(path) if asks and (request := asked(data))]
    offered = list(exchanges(path))
    for number, request, data in offered:
        registers = taken(number, request, data)
        assert registers is not None
        assert registers == by_the_standard(number, request, data)
    answers = [data for asks, _, data in packets(path) if not asks and data[7] == 4]
    assert sum(request.function == 4 for _, request in requests) == 3264
    assert len(answers) == 1551
    # the first answer's request was sent before the capture began
    paired = {data for *_, data in offered}
    assert [data for data in answers if data not in paired] == [answers[0]]
    figures.figure(
        f"Modbus capture: {len(offered)} replies of a real device to {len(requests)} requests, all read"
    )


@pytest.mark.parametrize("name", CAPTURES)
def test_malformed_replies_are_never_taken_whatever_was_asked(name: str) -> None:
    """Hold every packet that a device sent against requests it might answer, right ones and wrong ones."""
    offered = accepted = 0
    for asks, _, data in list(packets(capture(name)))[:400]:
        if asks:
            continue
        number, unit = int.from_bytes(data[:2], "big"), data[6] if len(data) > 6 else 0
        for function in (1, 2, 3, 4, 24):
            for count in (1, 2, 4, 14, 100, 125, (len(data) - 9) // 2 % 126):
                request = Request(unit, function, 0, count)
                good = by_the_standard(number, request, data) if function != 24 else None
                assert taken(number, request, data) == good, (data.hex(" "), request)
                offered += 1
                accepted += good is not None
    figures.figure(f"Modbus capture {name}: {offered} replies offered, {accepted} good ones taken, no other")


@pytest.mark.parametrize("name", CAPTURES)
def test_captured_bytes_that_are_no_rtu_are_noise_on_a_serial_line(name: str) -> None:
    for _, _, data in list(packets(capture(name)))[:400]:
        for function, count in ((3, 1), (4, 2), (4, 14), (24, 0)):
            for unit in (0, 1, 17, 255):
                try:
                    assert RtuFrames().reply(data, Request(unit, function, 0, count)) is None
                except ReplyError as error:
                    pytest.fail(f"{data.hex(' ')}: {error}")


def test_captured_replies_of_another_transaction_or_unit_are_refused() -> None:
    rng = np.random.default_rng(3)
    offered = list(exchanges(capture("modbus_test_2.pcap")))[:300]
    for number, request, data in offered:
        other = Request(
            request.unit ^ int(rng.integers(1, 255)), request.function, request.address, request.count
        )
        assert taken(number ^ int(rng.integers(1, 65535)), request, data) is None
        assert taken(number, other, data) is None
