"""Shared Modbus lines on a played machine: late and missing answers, exceptions, who is asked when."""

import contextlib
import struct
from collections import Counter

import numpy as np
import pytest

from drivers import clock
from drivers.modbus.driver import ModbusDriver
from drivers.modbus.frames import ReplyError, Request, RtuFrames
from drivers.modbus.line import ModbusLine
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.units import LaterError
from drivers.pipe import serial_pipe
from drivers.port import DriverConfigError, DriverIOError, SourceRequest
from drivers.serial_port import SerialKeys
from tests.conformance.modbus_device import crc16
from tests.unit.drivers.played_line import PlayedLine, played, read_on, silent

FIELD = [{"name": "a", "type": "uint16", "address": 40}]
POLL = {"mode": "poll", "period_s": 0.1, "fields": FIELD}
RTU = {"transport": "rtu", "port": "/line"}


def numbers(pdu: bytes) -> bytes:
    """Answer a read request with registers that hold their own addresses."""
    function, address, count = struct.unpack(">BHH", pdu)
    return struct.pack(f">BB{count}H", function, 2 * count, *((address + k) % 65536 for k in range(count)))


def rtu(unit: int, pdu: bytes) -> bytes:
    body = bytes([unit]) + pdu
    return body + crc16(body)


def tcp(request: bytes, pdu: bytes) -> bytes:
    return request[:4] + struct.pack(">HB", len(pdu) + 1, request[6]) + pdu


def sound_rtu(request: bytes) -> tuple[bytes, float]:
    return rtu(request[0], numbers(request[1:-2])), 0.005


def driver_of(**keys: object) -> ModbusDriver:
    settings = ModbusSettings.model_validate({**POLL, **keys})
    return ModbusDriver(
        SourceRequest(f"unit{settings.device_id}", settings, tuple(f.name for f in settings.fields))
    )


@pytest.mark.parametrize("count", [3_000, pytest.param(100_000, marks=pytest.mark.soak)])
@pytest.mark.parametrize("slowest_s", [0.25, 1.2])
def test_rtu_answers_that_come_late_are_never_taken_for_others(
    rng: np.random.Generator, count: int, slowest_s: float
) -> None:
    timeout_s = 0.1

    def slow(request: bytes) -> tuple[bytes, float]:
        seconds = rng.uniform(timeout_s, slowest_s) if rng.random() < 0.3 else 0.005
        return rtu(request[0], numbers(request[1:-2])), float(seconds)

    with played(slow):
        line = ModbusLine(lambda: serial_pipe(SerialKeys(port="x"), "x"), RtuFrames(), 0.002)
        answered, faults, kinds = 0, Counter[str](), set[str]()
        for _ in range(count):
            request = Request(1, 4, int(rng.integers(100)), int(rng.choice([4, 5])))
            try:
                data = line.ask(request, timeout_s, 0.0, faults, spare=8)
            except LaterError as later:
                clock.sleep(later.until - clock.monotonic())
            except ReplyError as error:
                kinds.add(error.kind)
            else:
                answered += 1
                assert data.view(">u2").tolist() == list(
                    range(request.address, request.address + request.count)
                )
    assert kinds == {"timeout"}
    assert answered > 0.05 * count
    assert faults["late reply"] + faults["stray bytes"] > 0.02 * count


def test_rtu_unit_after_a_timeout_is_asked_for_another_length_first() -> None:
    delays = iter([0.005, 0.14, *[0.005] * 20])
    with played(lambda request: (sound_rtu(request)[0], next(delays))) as line:
        driver = driver_of(**RTU, timeout_s=0.1, fields=[{"name": "a", "type": "uint32", "address": 40}])
        driver.open()
        got = [driver.read(0.1) for _ in range(8)]
        driver.close()
    assert {float(v) for block in got for v in block.values[:, 0]} == {40 * 65536 + 41.0}
    asked = [struct.unpack(">H", request[4:6])[0] for _, request in line.requests]
    assert asked[:5] == [2, 2, 1, 2, 2]
    times = [at for at, _ in line.requests]
    assert (
        times[2] - times[1] >= 0.15 - 1e-6
    )  # its time-out, and a while in which a late answer meets no request
    assert driver.counts.faults["timeout"] == 1
    assert driver.counts.received == sum(map(len, got)) + driver.counts.rejected.total()


def test_rtu_unit_that_answered_another_length_owes_nothing_any_more() -> None:
    delays = iter([0.005, 0.14, 0.005, 0.005])
    with played(lambda request: (sound_rtu(request)[0], next(delays))) as line:
        rtu_line = ModbusLine(lambda: serial_pipe(SerialKeys(port="x"), "x"), RtuFrames(), 0.002)
        faults = Counter[str]()
        for count in (4, 4, 5, 4):
            clock.sleep(0.3)
            with contextlib.suppress(ReplyError):
                rtu_line.ask(Request(1, 4, 40, count), 0.1, 0.0, faults)
    assert [struct.unpack(">H", request[4:6])[0] for _, request in line.requests] == [4, 4, 5, 4]


def test_rtu_unit_of_one_register_is_asked_for_more_and_its_refusal_is_an_answer_too() -> None:
    def answer(request: bytes) -> tuple[bytes, float]:
        if len(line.requests) == 2:
            return b"", 0.0
        count = struct.unpack(">H", request[4:6])[0]
        return rtu(request[0], numbers(request[1:-2]) if count == 1 else bytes([0x84, 2])), 0.005

    line = PlayedLine(answer)
    with clock.playing(line):
        driver = driver_of(**RTU, timeout_s=0.1)
        driver.open()
        got = [driver.read(0.1) for _ in range(8)]
        driver.close()
    assert [struct.unpack(">H", request[4:6])[0] for _, request in line.requests][:5] == [1, 1, 2, 1, 1]
    assert {float(v) for block in got for v in block.values[:, 0]} == {40.0}
    assert driver.counts.faults == {"timeout": 1}


def test_rtu_unit_that_became_slower_is_given_its_whole_time_again() -> None:
    def answer(request: bytes) -> tuple[bytes, float]:
        if len(line.requests) == 2:
            return b"", 0.0
        return sound_rtu(request)[0], 0.005 if len(line.requests) == 1 else 0.08

    line = PlayedLine(answer)
    with clock.playing(line):
        driver = driver_of(**RTU, timeout_s=0.1)
        driver.open()
        assert len(driver.read(0.1)) == 1
        while not len(driver.read(0.1)):
            assert len(line.requests) < 8
        driver.close()


def test_tcp_answer_that_stops_amid_costs_the_connection_and_not_the_source() -> None:
    def answer(request: bytes) -> tuple[bytes, float]:
        whole = tcp(request, numbers(request[7:]))
        if len(line.requests) != 2:
            return whole, 0.001
        line.coming.append((line.now_ns + 600_000_000, whole[6:]))
        return whole[:6], 0.001

    line = PlayedLine(answer)
    with clock.playing(line):
        driver = driver_of(timeout_s=0.5)
        driver.open()
        blocks = [driver.read(0.2) for _ in range(8)]
        driver.close()
    assert {float(v) for block in blocks for v in block.values[:, 0]} == {40.0}
    assert driver.counts.faults == {"timeout": 1}
    assert line.connections == 2


def test_ring_whose_slots_are_owed_waits_for_them_without_spinning() -> None:
    lost = [2, 3]

    def answer(request: bytes) -> tuple[bytes, float]:
        address = struct.unpack(">H", request[2:4])[0]
        if address >= 16 and len(line.requests) in lost:
            return b"", 0.0
        pdu = bytes([4, 4, 0, 0, 0, 9]) if address == 0 else numbers(request[1:-2])
        return rtu(request[0], pdu), 0.002

    line = PlayedLine(answer)
    ring = {"mode": "ring", "index": {"address": 0}, "ring": {"address": 16, "slots": 20}, "timeout_s": 0.3}
    with clock.playing(line):
        driver = driver_of(**{**POLL, **RTU, **ring, "fields": [{"name": "a", "type": "uint16"}]})
        driver.open()
        reads = 0
        while not len(driver.read(0.1)):
            reads += 1
            assert reads < 30
        driver.close()
    assert driver.counts.faults["timeout"] == 2


def test_rtu_answer_that_comes_after_the_line_was_given_up_is_not_taken_for_the_next_one() -> None:
    line = PlayedLine(silent)
    with clock.playing(line):
        driver = driver_of(
            **RTU, timeout_s=0.1, gap=0, fields=[{"name": "a", "type": "uint32", "address": 40}]
        )
        driver.open()
        with pytest.raises(DriverIOError, match="in a row"):
            read_on(driver, 0.1)
        driver.close()
        line.answer = sound_rtu
        clock.sleep(0.5)
        driver.open()
        late = rtu(1, bytes([4, 4]) + b"\xde\xad\xbe\xef")
        line.coming.append((line.now_ns + 1_000_000, late))
        got = [driver.read(0.2) for _ in range(4)]
        driver.close()
    assert {float(v) for block in got for v in block.values[:, 0]} == {40 * 65536 + 41.0}


def test_tcp_answer_that_comes_late_is_passed_over_and_the_connection_kept() -> None:
    seconds = iter([0.6, *[0.01] * 20])

    def slow(request: bytes) -> tuple[bytes, float]:
        return tcp(request, numbers(request[7:])), next(seconds)

    with played(slow) as line:
        driver = driver_of(timeout_s=0.5)
        driver.open()
        blocks = [driver.read(0.2) for _ in range(6)]
        driver.close()
    assert {float(v) for block in blocks for v in block.values[:, 0]} == {40.0}
    assert line.connections == 1
    assert driver.counts.faults == {"timeout": 1, "late reply": 1}
    assert driver.counts.rejected == {"no answer": 1}


def exception(code: int) -> PlayedLine:
    return PlayedLine(lambda request: (rtu(request[0], bytes([request[1] | 0x80, code])), 0.002))


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (1, r"exception 1 \(illegal function\) .*; look at function, 3 or 4"),
        (2, r"exception 2 \(illegal data address\) .*; look at address, which counts from 0"),
        (3, r"exception 3 \(illegal data value\) .*; the device takes fewer registers"),
        (4, r"exception 4 \(device failure\) .*\(3 in a row\)"),
        (8, r"exception 8 \(memory parity error\) .*\(3 in a row\)"),
        (10, r"exception 10 \(gateway path unavailable\) .*; look at the gateway's table"),
        (11, r"exception 11 \(gateway target does not answer\) .*\(3 in a row\)"),
        (0x55, r"exception 85 \(not a code of the standard\) .*\(3 in a row\)"),
    ],
)
def test_exception_is_named_counted_and_raised_with_advice(code: int, words: str) -> None:
    line = exception(code)
    with clock.playing(line):
        driver = driver_of(**RTU)
        driver.open()
        with pytest.raises(DriverIOError, match=words):
            read_on(driver, 0.5)
        driver.close()
    asked = 1 if code in {1, 2, 3} else 3
    assert len(line.requests) == asked
    ((kind, times),) = driver.counts.faults.items()
    assert kind.startswith(f"exception {code} (")
    assert times == asked
    polls = 3 if code in {10, 11} else 1
    assert driver.counts.rejected["no answer"] == driver.counts.received == polls


@pytest.mark.parametrize("code", [5, 6])
def test_device_that_is_busy_is_asked_later_and_ever_later(code: int) -> None:
    busy = 6
    line = exception(code)
    refuse = line.answer
    line.answer = lambda request: refuse(request) if len(line.requests) <= busy else sound_rtu(request)
    with clock.playing(line):
        driver = driver_of(**RTU, period_s=0.02)
        driver.open()
        blocks = [driver.read(0.2)]
        while not len(blocks[-1]):
            blocks.append(driver.read(0.2))
        driver.close()
    times = [at for at, _ in line.requests[: busy + 1]]
    pauses = np.diff(times)
    assert pauses.tolist() == sorted(pauses.tolist())
    assert pauses[0] >= 0.05
    assert pauses[-1] <= 1.2
    assert driver.counts.faults.total() == busy == driver.counts.rejected["no answer"]


def test_silent_unit_is_given_the_time_its_answers_used_to_take() -> None:
    line = PlayedLine(lambda request: (b"", 0.0) if request[0] == 2 else sound_rtu(request))
    with clock.playing(line):
        sound, silent = driver_of(**RTU, device_id=1), driver_of(**RTU, device_id=2)
        sound.open()
        silent.open()
        sound.read(0.2)
        taken = []
        for _ in range(18):
            begun = clock.monotonic()
            try:
                silent.read(0.0)
            except DriverIOError:
                silent.close()
                silent.open()
            taken.append(clock.monotonic() - begun)
            clock.sleep(1.1)
        sound.close()
        silent.close()
    long = {number: round(seconds, 2) for number, seconds in enumerate(taken) if seconds > 0.1}
    assert long == {0: 0.5, 16: 0.5}
    assert max(seconds for seconds in taken if seconds <= 0.1) < 0.06


def test_answer_that_comes_late_is_counted_where_it_was_asked_for() -> None:
    """A gateway keeps the next one waiting while it waits for a slow unit: the next one has no fault."""
    seconds = {1: 0.005, 2: 0.3}
    with played(lambda request: (tcp(request, numbers(request[7:])), seconds[request[6]])) as line:
        quick, slow = driver_of(device_id=1), driver_of(device_id=2, timeout_s=0.2)
        quick.open()
        slow.open()
        assert len(slow.read(0.0)) == 0
        assert len(quick.read(0.0)) == 1
        quick.close()
        slow.close()
    assert line.connections == 1
    assert quick.counts.faults == {}
    assert slow.counts.faults == {"timeout": 1, "late reply": 1}


def test_bytes_that_come_late_on_a_serial_line_are_counted_where_they_were_asked_for() -> None:
    with played(lambda request: (sound_rtu(request)[0], 0.005 if request[0] == 1 else 0.12)) as line:
        quick, slow = driver_of(**RTU, device_id=1), driver_of(**RTU, device_id=2, timeout_s=0.1)
        quick.open()
        slow.open()
        assert len(slow.read(0.0)) == 0
        clock.sleep(0.05)
        assert len(quick.read(0.0)) == 1
        quick.close()
        slow.close()
    assert len(line.requests) == 2
    assert quick.counts.faults == {}
    assert slow.counts.faults == {"timeout": 1, "stray bytes": 7}


def test_unit_that_is_lost_is_not_asked_more_often_than_its_share_and_no_poll_of_it_counts_meanwhile() -> (
    None
):
    line = PlayedLine(lambda request: (b"", 0.0) if request[0] == 2 else sound_rtu(request))
    with clock.playing(line):
        sound, lost = driver_of(**RTU, device_id=1), driver_of(**RTU, device_id=2, timeout_s=0.1)
        end = clock.monotonic() + 20.0
        sound.open()
        lost.open()
        while clock.monotonic() < end:
            sound.read(0.0)
            try:
                lost.read(0.0)
            except DriverIOError:
                lost.close()
                lost.open()
            clock.sleep(0.01)
        sound.close()
        lost.close()
    asked = [at for at, request in line.requests if request[0] == 2]
    assert np.diff(asked)[4:].min() > 1.3
    assert lost.counts.received == lost.counts.rejected["no answer"] == len(asked)


def test_line_without_any_answer_is_opened_anew() -> None:
    with played(silent) as line:
        driver = driver_of(timeout_s=0.1)
        driver.open()
        with pytest.raises(DriverIOError, match=r"no reply in time to function 4, .*\(3 in a row\)"):
            read_on(driver)
        driver.open()
        driver.close()
    assert line.connections == 2


def test_connection_over_which_nobody_answers_is_made_anew_though_others_hold_it() -> None:
    line = PlayedLine(lambda request: (tcp(request, numbers(request[7:])), 0.001))
    with clock.playing(line):
        drivers = [driver_of(device_id=unit, timeout_s=0.1) for unit in (1, 2, 3)]
        for driver in drivers:
            driver.open()
            assert len(driver.read(0.2)) == 1
        line.answer = silent
        clock.sleep(0.2)
        assert [len(driver.read(0.2)) for driver in drivers] == [0, 0, 0]
        line.answer = lambda request: (tcp(request, numbers(request[7:])), 0.001)
        clock.sleep(0.2)
        assert all(len(driver.read(0.2)) for driver in drivers)
        assert line.connections == 2
        for driver in drivers:
            driver.close()


def test_sources_of_one_line_share_a_connection_until_the_last_is_closed() -> None:
    with played(sound_rtu) as line:
        one, other = driver_of(**RTU, device_id=1), driver_of(**RTU, device_id=2)
        one.open()
        other.open()
        assert len(one.read(0.2)) == len(other.read(0.2)) == 1
        one.close()
        assert len(other.read(0.2)) == 1
        assert line.connections == 1
        other.close()
        one.open()
        assert line.connections == 2
        with pytest.raises(
            DriverConfigError, match="/line: 9600 baud, parity N, 1 stop bits here and 19200 baud"
        ):
            driver_of(**RTU, device_id=3, baudrate=9600).open()
        one.close()


def test_tcp_source_that_does_not_share_has_a_connection_of_its_own() -> None:
    with played(lambda request: (tcp(request, numbers(request[7:])), 0.001)) as line:
        drivers = [
            driver_of(device_id=unit, share=share) for unit, share in ((1, True), (2, True), (3, False))
        ]
        for driver in drivers:
            driver.open()
            driver.read(0.1)
        assert line.connections == 2
        for driver in drivers:
            driver.close()


def test_line_that_one_source_lost_is_opened_by_the_next_one_to_ask() -> None:
    line = PlayedLine(
        lambda request: (b"\xff" * 20 if request[6] == 1 else tcp(request, numbers(request[7:])), 0.001)
    )
    with clock.playing(line):
        liar, honest = driver_of(device_id=1), driver_of(device_id=2)
        liar.open()
        honest.open()
        with pytest.raises(DriverIOError, match="not Modbus"):
            liar.read(0.2)
        assert len(honest.read(0.2)) == 1
        assert line.connections == 4  # one for each of the liar's three tries, one for the honest unit
        liar.close()
        honest.close()


def test_rtu_frames_have_the_standards_silence_between_them() -> None:
    with played(sound_rtu) as line:
        driver = driver_of(**RTU, baudrate=9600, period_s=0.001)
        driver.open()
        for _ in range(4):
            driver.read(0.05)
        driver.close()
    gaps = np.diff([at for at, _ in line.requests]) - 0.005
    assert gaps.min() >= 3.5 * 11 / 9600 - 1e-6


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({**RTU, "device_id": 0}, "calls all units"),
        ({**RTU, "share": False}, "false is for TCP"),
        ({"gap": 121}, "less than or equal to 120"),
    ],
)
def test_settings_of_a_shared_line_that_cannot_work_are_refused(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ModbusSettings.model_validate({**POLL, **keys})


def test_check_points_out_a_port_that_a_replug_may_change() -> None:
    assert "a replug may change it" in driver_of(transport="rtu", port="/dev/ttyUSB3").hints()[0]
    assert driver_of().hints() == ()


@pytest.mark.parametrize(
    ("keys", "registers"),
    [
        ({"mode": "ring", "index": {"address": 0}, "ring": {"address": 16, "slots": 99}}, 124),
        ({"mode": "fifo", "address": 7}, 31),
    ],
)
def test_check_points_out_an_answer_that_cannot_come_in_time(keys: dict[str, object], registers: int) -> None:
    def hints(baudrate: int) -> tuple[str, ...]:
        fields = [{"name": "a", "type": "int32"}, {"name": "b", "type": "int32"}]
        settings = ModbusSettings.model_validate({**RTU, **keys, "fields": fields, "baudrate": baudrate})
        return ModbusDriver(SourceRequest("x", settings, ("a",))).hints()

    assert hints(19200) == ()
    (hint,) = hints(1200)
    assert hint.startswith(f"an answer of {registers} registers takes ")
    assert hint.endswith(" s at 1200 baud, and has 0.5 s; raise timeout_s or baudrate")
