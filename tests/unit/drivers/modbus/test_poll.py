"""Polled registers: what is asked in one request, what is left out, and that no sample is lost in between."""

import struct

import numpy as np
import pytest

from drivers import clock
from drivers.modbus.driver import ModbusDriver
from drivers.modbus.poll import poll_plan
from drivers.modbus.settings import ModbusSettings
from drivers.port import DriverIOError, SourceRequest
from tests.unit.drivers.modbus.test_line import numbers, tcp
from tests.unit.drivers.played_line import PlayedLine, played, read_on


def settings(addresses: dict[str, int], kind: str = "uint16", **keys: object) -> ModbusSettings:
    fields = [{"name": name, "type": kind, "address": address} for name, address in addresses.items()]
    return ModbusSettings.model_validate({"mode": "poll", "period_s": 0.1, "fields": fields, **keys})


def asked(addresses: dict[str, int], gap: int, kind: str = "uint16") -> list[tuple[int, int]]:
    made = settings(addresses, kind, gap=gap)
    plan = poll_plan(sorted(made.fields, key=lambda field: field.address or 0), made)
    return [(request.address, request.count) for request in plan.requests]


@pytest.mark.parametrize(
    ("gap", "requests"),
    [
        (0, [(10, 2), (14, 1), (20, 1), (200, 1)]),
        (1, [(10, 2), (14, 1), (20, 1), (200, 1)]),
        (2, [(10, 5), (20, 1), (200, 1)]),
        (5, [(10, 11), (200, 1)]),
        (120, [(10, 11), (200, 1)]),
    ],
)
def test_plan_reads_over_gaps_up_to_the_limit(gap: int, requests: list[tuple[int, int]]) -> None:
    assert asked({"e": 200, "a": 10, "b": 11, "c": 14, "d": 20}, gap) == requests


def test_plan_never_asks_for_more_than_a_request_carries() -> None:
    assert asked({"a": 0, "b": 100, "c": 123, "d": 125}, 120) == [(0, 124), (125, 1)]
    assert asked({"a": 0, "b": 124}, 120, "uint32") == [(0, 2), (124, 2)]


class Holed:
    """A device that has some registers only, each holding its own address."""

    def __init__(self, *there: range, code: int = 2) -> None:
        self.there = {address for part in there for address in part}
        self.code = code
        self.asked: list[tuple[int, int]] = []

    def __call__(self, request: bytes) -> tuple[bytes, float]:
        address, count = struct.unpack(">HH", request[8:12])
        self.asked.append((address, count))
        whole = set(range(address, address + count)) <= self.there
        return tcp(request, numbers(request[7:]) if whole else bytes([request[7] | 0x80, self.code])), 0.001


@pytest.mark.parametrize("code", [2, 3])
def test_gap_that_the_device_refuses_is_left_out_from_then_on_and_costs_no_sample(code: int) -> None:
    device = Holed(range(40, 42), range(45, 46), range(48, 50), code=code)
    addresses = {"a": 40, "b": 41, "c": 45, "d": 48, "e": 49}
    with played(device):
        driver = ModbusDriver(SourceRequest("plc", settings(addresses), ("e", "c", "a"), "d"))
        driver.open()
        blocks = [driver.read(0.25) for _ in range(4)]
        driver.close()
    values = np.concatenate([block.values for block in blocks])
    assert values.tolist() == [[49.0, 45.0, 40.0]] * len(values)
    assert device.asked[0] == (40, 10)
    assert device.asked[1:4] == [(40, 2), (45, 1), (48, 2)]
    assert device.asked.count((40, 10)) == 1
    assert driver.counts.received == len(values) >= 4
    assert driver.counts.faults == {
        "gap refused": 1,
        f"exception {code} ({'illegal data address' if code == 2 else 'illegal data value'})": 1,
    }
    assert "the gaps in it are left out from now on" in driver.take_notes()[0]


def test_register_that_does_not_exist_is_raised_when_nothing_is_left_to_leave_out() -> None:
    device = Holed(range(40, 42))
    with played(device):
        driver = ModbusDriver(SourceRequest("plc", settings({"a": 40, "b": 45}), ("a", "b")))
        driver.open()
        with pytest.raises(DriverIOError, match=r"registers 45 to 45; look at address, which counts from 0"):
            read_on(driver)
        driver.close()
    assert device.asked == [(40, 6), (40, 1), (45, 1)]
    assert driver.counts.received == driver.counts.rejected["no answer"] == 1


def test_sample_before_a_failure_is_delivered_and_the_failure_told_afterwards() -> None:
    sound = Holed(range(100))
    line = PlayedLine(sound)
    line.answer = lambda request: sound(request) if len(line.requests) < 3 else (b"\xff" * 12, 0.001)
    with clock.playing(line):
        driver = ModbusDriver(SourceRequest("plc", settings({"a": 40}, period_s=0.001), ("a",)))
        driver.open()
        delivered = len(driver.read(0.1))
        with pytest.raises(DriverIOError, match="not Modbus"):
            read_on(driver)
        driver.close()
    assert delivered == 2
    assert driver.counts.received == 3 == delivered + driver.counts.rejected["no answer"]
