import struct
from collections.abc import Iterator

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.modbus.driver import ModbusDriver
from drivers.modbus.settings import ModbusSettings
from drivers.port import DriverIOError, SampleBlock, SourceRequest
from drivers.write_gate import ForbiddenWriteError, check
from tests.conformance.modbus_device import Registers, TcpDevice
from tests.unit.drivers.played_line import read_on

SLOTS = 100
RING = {
    "mode": "ring", "index": {"address": 0}, "ring": {"address": 16, "slots": SLOTS}, "period_s": 0.001,
    "timeout_s": 0.2, "fields": [{"name": "a", "type": "uint32"}],
}  # fmt: skip


OPENED: list[ModbusDriver] = []


@pytest.fixture
def device() -> Iterator[TcpDevice]:
    tcp = TcpDevice(Registers())
    tcp.start()
    yield tcp
    while OPENED:
        OPENED.pop().close()
    tcp.close()


def write_samples(registers: Registers, first: int, count: int) -> None:
    """Write samples that carry their own number, as a device with a wrapping index does."""
    for number in range(first, first + count):
        raw = number % 2**32
        start = 16 + 2 * (raw % SLOTS)
        registers.words[start : start + 2] = [raw >> 16, raw & 0xFFFF]
        registers.words[0:2] = [((raw + 1) >> 16) & 0xFFFF, (raw + 1) & 0xFFFF]


def driver_of(device: TcpDevice, **keys: object) -> ModbusDriver:
    settings = ModbusSettings.model_validate({**RING, "host": "127.0.0.1", "port": device.port, **keys})
    OPENED.append(
        ModbusDriver(SourceRequest("line", settings, tuple(field.name for field in settings.fields)))
    )
    return OPENED[-1]


def read_all(driver: ModbusDriver) -> SampleBlock:
    """Read until a read brings nothing."""
    blocks = [driver.read(0.05)]
    while len(blocks[-1]):
        blocks.append(driver.read(0.05))
    counters = [block.counter for block in blocks[:-1] if block.counter is not None]
    return SampleBlock(
        np.concatenate([b.values for b in blocks]), 0, np.concatenate([*counters, np.empty(0, np.int64)]),
        None,
        blocks[-1].epoch,
    )  # fmt: skip


def test_ring_at_first_contact_is_read_but_for_the_slot_being_written(device: TcpDevice) -> None:
    write_samples(device.registers, 0, 250)
    driver = driver_of(device)
    driver.open()
    block = read_all(driver)
    assert block.counter is not None
    assert block.counter.tolist() == list(range(151, 250)) == block.values[:, 0].tolist()
    assert driver.counts.received == 99


def test_ring_whose_index_wraps_is_read_on(device: TcpDevice) -> None:
    start = 2**32 - 30
    write_samples(device.registers, start, 10)
    driver = driver_of(device)
    driver.open()
    read_all(driver)
    write_samples(device.registers, start + 10, 100 - 11)
    block = read_all(driver)
    expected = [n % 2**32 for n in range(start + 10, start + 99)]
    assert block.counter is not None
    # 2**32 is no multiple of the 100 slots: samples beyond the wrap may overwrite some of those before it
    assert block.counter.tolist() == expected
    assert block.values[:, 0].tolist() == expected
    write_samples(device.registers, start + 99, 99)
    assert read_all(driver).values[:, 0].tolist() == list(range(69, 168))


def test_ring_whose_index_wraps_rejects_what_the_wrap_overwrote(device: TcpDevice) -> None:
    start = 2**32 - 20  # in slots 76 to 95; the samples after the wrap begin in slot 0
    driver = driver_of(device)
    device.registers.words[0:2] = [0xFFFF, 0xFFFF - 19]
    driver.open()
    read_all(driver)
    received = driver.counts.received
    write_samples(device.registers, start, 99)
    block = read_all(driver)
    assert block.counter is not None
    assert block.values[:, 0].tolist() == block.counter.tolist()
    assert block.counter.tolist() == [*range(2**32 - 16, 2**32), *range(79)]
    assert driver.counts.rejected == {"overrun": 4}
    assert driver.counts.received == received + 99


def test_ring_after_reopen_goes_on_from_the_last_sample_delivered(device: TcpDevice) -> None:
    driver = driver_of(device)
    driver.open()
    write_samples(device.registers, 0, 20)
    assert len(read_all(driver).values) == 20
    driver.close()
    write_samples(device.registers, 20, 70)
    driver.open()
    assert read_all(driver).values[:, 0].tolist() == list(range(20, 90))


def test_ring_left_alone_too_long_counts_what_it_lost(device: TcpDevice) -> None:
    driver = driver_of(device)
    driver.open()
    write_samples(device.registers, 0, 20)
    read_all(driver)
    write_samples(device.registers, 20, 180)
    assert read_all(driver).values[:, 0].tolist() == list(range(101, 200))
    assert driver.counts.dropped == {"overrun": 81}
    assert driver.counts.received == 119


def test_ring_that_runs_on_while_it_is_read_rejects_the_overtaken_slots(device: TcpDevice) -> None:
    written = 100
    write_samples(device.registers, 0, written)

    def run_on(pdu: bytes) -> None:
        nonlocal written
        if struct.unpack(">H", pdu[1:3])[0] >= 16:
            write_samples(device.registers, written, 15)
            written += 15

    driver = driver_of(device)
    device.registers.before_answer = run_on
    driver.open()
    block = driver.read(0.05)
    assert block.counter is not None
    assert block.values[:, 0].tolist() == block.counter.tolist() == list(range(31, 100))
    assert driver.counts.rejected == {"overrun": 30}
    assert driver.counts.received == 99


def test_ring_whose_device_restarts_is_read_anew_and_says_so(device: TcpDevice) -> None:
    driver = driver_of(device)
    driver.open()
    write_samples(device.registers, 0, 50)
    assert read_all(driver).epoch == 0
    write_samples(device.registers, 0, 5)
    block = read_all(driver)
    assert block.values[:, 0].tolist() == [0, 1, 2, 3, 4]
    assert block.epoch == 1
    assert driver.counts.faults == {"restart": 1}
    assert "restarted" in driver.take_notes()[0]


LIES = {
    "another unit": lambda r: r[:6] + b"\x02" + r[7:],
    "another transaction": lambda r: b"\x99\x99" + r[2:],
    "another protocol": lambda r: r[:2] + b"\x00\x01" + r[4:],
    "another function": lambda r: r[:7] + b"\x03" + r[8:],
    "one register less": lambda r: r[:5] + bytes([r[5] - 2, r[6], r[7], r[8] - 2]) + r[9:-2],
    "one register more": lambda r: r[:5] + bytes([r[5] + 2, r[6], r[7], r[8] + 2]) + r[9:] + b"\x00\x00",
    "an odd byte count": lambda r: r[:5] + bytes([r[5] - 1, r[6], r[7], r[8] - 1]) + r[9:-1],
    "a byte count that disagrees": lambda r: r[:8] + bytes([r[8] + 2]) + r[9:],
    "two replies at once": lambda r: r + r,
    "an exception without code": lambda r: r[:4] + b"\x00\x02" + r[6:7] + b"\x84",
    "exception 2": lambda r: r[:4] + b"\x00\x03" + r[6:7] + b"\x84\x02",
    "a length of 60,000": lambda r: r[:4] + b"\xea\x60" + r[6:],
    "half a reply": lambda r: r[: len(r) // 2],
    "nothing": lambda _: b"",
    "noise": lambda _: b"\xff" * 50,
}


@pytest.mark.parametrize("lie", sorted(LIES))
def test_reply_that_does_not_answer_its_request_is_never_taken_for_data(device: TcpDevice, lie: str) -> None:
    driver = driver_of(device)
    driver.open()
    write_samples(device.registers, 0, 10)
    read_all(driver)
    write_samples(device.registers, 10, 10)
    device.lie = LIES[lie]
    with pytest.raises(DriverIOError, match=r"127\.0\.0\.1"):
        read_on(driver, 0.1)  # a reply that is missing or bad is asked for again
    assert driver.counts.received == 10
    assert driver.counts.faults.total() == (1 if lie == "exception 2" else 3)
    device.lie = None
    driver.close()
    driver.open()
    assert read_all(driver).values[:, 0].tolist() == list(range(10, 20))


def test_reply_in_single_bytes_is_put_together(device: TcpDevice) -> None:
    driver = driver_of(device)
    driver.open()
    write_samples(device.registers, 0, 3)
    assert driver._line is not None
    frames = driver._line.frames
    whole = frames.reply
    frames.reply = lambda data, request: None if len(data) < 9 else whole(data, request)  # type: ignore[method-assign]
    assert len(read_all(driver).values) == 3


def test_poll_asks_neighbouring_registers_at_once_and_puts_fields_in_order(device: TcpDevice) -> None:
    fields = [
        {"name": "x", "type": "int16", "address": 40},
        {"name": "b", "type": "uint8", "address": 300},
        {"name": "n", "type": "uint32", "address": 41},
    ]
    settings = ModbusSettings.model_validate(
        {"mode": "poll", "host": "127.0.0.1", "port": device.port, "fields": fields, "period_s": 0.001}
    )
    driver = ModbusDriver(SourceRequest("line", settings, ("b", "x"), "n"))
    OPENED.append(driver)
    device.registers.words[40:43] = [0xFFFE, 1, 2]
    device.registers.words[300] = 0x1234
    driver.open()
    block = driver.read(1.0)
    assert block.counter is not None
    assert block.values[0].tolist() == [0x34, -2]
    assert block.counter[0] == 65538
    assert {request[7:] for request in device.registers.requests} == {
        b"\x04\x00\x28\x00\x03",
        b"\x04\x01\x2c\x00\x01",
    }
    assert driver.counts.received == len(block)


ORDERS = {
    "ABCD": (struct.pack(">i", -70000), struct.pack(">h", -300)),
    "CDAB": (struct.pack(">i", -70000)[2:] + struct.pack(">i", -70000)[:2], struct.pack(">h", -300)),
    "BADC": (struct.pack("<i", -70000)[2:] + struct.pack("<i", -70000)[:2], struct.pack("<h", -300)),
    "DCBA": (struct.pack("<i", -70000), struct.pack("<h", -300)),
}


def put(device: TcpDevice, address: int, data: bytes) -> None:
    device.registers.words[address : address + len(data) // 2] = np.frombuffer(data, ">u2")


@pytest.mark.parametrize("order", sorted(ORDERS))
def test_poll_of_each_byte_order_reads_numbers_of_one_two_and_four_bytes(
    device: TcpDevice, order: str
) -> None:
    long, short = ORDERS[order]
    put(device, 40, long)
    put(device, 50, short)
    put(device, 52, b"\x00\xfe" if order in {"ABCD", "CDAB"} else b"\xfe\x00")
    kinds = {"byte": ("int8", 52), "long": ("int32", 40), "short": ("int16", 50)}
    fields = [{"name": name, "type": kind, "address": address} for name, (kind, address) in kinds.items()]
    keys = {"mode": "poll", "host": "127.0.0.1", "port": device.port, "period_s": 0.001, "byte_order": order}
    settings = ModbusSettings.model_validate({**keys, "fields": fields})
    driver = ModbusDriver(SourceRequest("line", settings, ("byte", "long", "short")))
    OPENED.append(driver)
    driver.open()
    assert driver.read(1.0).values[0].tolist() == [-2, -70000, -300]


def test_poll_of_a_byte_and_longer_fields_in_any_order_works_with_words_swapped(device: TcpDevice) -> None:
    put(device, 40, b"\x00\x11")
    put(device, 41, ORDERS["CDAB"][0])
    fields = [{"name": "a", "type": "uint8", "address": 40}, {"name": "b", "type": "int32", "address": 41}]
    keys = {
        "mode": "poll",
        "host": "127.0.0.1",
        "port": device.port,
        "period_s": 0.001,
        "word_order": "little",
    }
    settings = ModbusSettings.model_validate({**keys, "fields": fields})
    driver = ModbusDriver(SourceRequest("line", settings, ("a", "b")))
    OPENED.append(driver)
    driver.open()
    assert driver.read(1.0).values[0].tolist() == [17, -70000]


@pytest.mark.parametrize("order", sorted(ORDERS))
def test_ring_of_each_byte_order_reads_its_index_and_its_slots_so(device: TcpDevice, order: str) -> None:
    settings = {**RING, "fields": [{"name": "a", "type": "int32"}], "byte_order": order}
    put(device, 16, ORDERS[order][0])
    one = {"ABCD": b"\0\0\0\1", "CDAB": b"\0\1\0\0", "BADC": b"\0\0\1\0", "DCBA": b"\1\0\0\0"}
    driver = driver_of(device, **settings)
    driver.open()
    put(device, 0, one[order])
    block = driver.read(0.05)
    assert block.values.tolist() == [[-70000.0]]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({**RING, "byte_order": "ABDC"}, "'ABCD', 'CDAB', 'BADC' or 'DCBA'"),
        ({**RING, "byte_order": "CDAB", "word_order": "big"}, "byte_order says the order of words too"),
        ({"mode": "ring"}, 'mode "ring" needs index and ring'),
        ({**RING, "address": 3}, 'mode "ring" has no address'),
        ({**RING, "fields": [{"name": "a", "type": "uint16", "address": 1}]}, "must not have an address"),
        ({**RING, "fields": [{"name": "a", "type": "uint8"}]}, "must be even"),
        ({**RING, "fields": [{"name": f"f{i}", "type": "float64"} for i in range(32)]}, "carries 250"),
        ({**RING, "fields": [{"name": "a", "type": "uint16"}] * 2}, "named twice"),
        ({**RING, "fields": []}, "at least 1 item"),
        ({**RING, "function": 6}, "function"),
        ({**RING, "port": "/dev/ttyS0"}, "needs a port number"),
        ({**RING, "transport": "rtu"}, "needs the path of its serial port"),
        ({**RING, "colour": 1}, "colour"),
        ({"mode": "poll", "fields": [{"name": "a", "type": "uint16"}]}, "a have none"),
        ({"mode": "fifo", "fields": [{"name": "a", "type": "uint16"}]}, 'mode "fifo" needs address'),
    ],
)
def test_settings_that_cannot_work_are_refused_in_words(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        ModbusSettings.model_validate({"fields": [{"name": "a", "type": "uint16"}], **keys})


@pytest.mark.parametrize(
    "pdu", [b"\x06\x00\x01\x00\x02", b"\x10\x00\x01\x00\x01\x02\x00\x00", b"\x04\x00\x01", b"\x17"]
)
def test_gate_refuses_whatever_is_no_read_request(pdu: bytes) -> None:
    with pytest.raises(ForbiddenWriteError):
        check("modbus-tcp", struct.pack(">HHHB", 1, 0, len(pdu) + 1, 1) + pdu)
