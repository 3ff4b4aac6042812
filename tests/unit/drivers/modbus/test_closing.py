"""Modbus servers that end idle connections, or each one after its answer: nothing is lost and nothing is
said."""

from collections.abc import Iterator

import numpy as np
import pytest

from drivers.modbus.driver import ModbusDriver
from drivers.modbus.settings import ModbusSettings
from drivers.port import DriverIOError, SourceRequest
from tests.conformance.modbus_device import Registers, TcpDevice
from tests.links import NotedLink
from tests.unit.drivers.modbus.test_driver import driver_of, read_all, write_samples
from tests.unit.drivers.played_line import read_on


@pytest.fixture
def device() -> Iterator[TcpDevice]:
    tcp = TcpDevice(Registers())
    tcp.start()
    yield tcp
    tcp.close()


def poller(device: TcpDevice, **keys: object) -> ModbusDriver:
    fields = [{"name": "a", "type": "uint16", "address": 40}]
    settings = ModbusSettings.model_validate(
        {
            "mode": "poll",
            "host": "127.0.0.1",
            "port": device.port,
            "fields": fields,
            "period_s": 0.001,
            **keys,
        }
    )
    return ModbusDriver(SourceRequest("plc", settings, ("a",)))


@pytest.mark.parametrize("share", [True, False])
@pytest.mark.parametrize("resets", [False, True])
def test_poll_of_a_server_that_ended_the_idle_connection_is_answered_and_no_event(
    device: TcpDevice, resets: bool, share: bool
) -> None:
    device.resets = resets
    driver = poller(device, share=share)
    link = NotedLink(driver, 3600.0)
    samples = 0
    for _ in range(20):
        samples += len(link.read(0.01))
        device.hang_up()
    link.close()
    assert samples >= 20
    assert driver.counts.received == samples
    assert driver.counts.faults == {}
    assert link.take_events() == []


@pytest.mark.parametrize(
    ("replies", "resets", "count"), [(1, False, 6000), (1, True, 1200), (3, False, 1200), (3, True, 1200)]
)
def test_ring_of_a_server_that_ends_connections_after_its_answers_is_read_whole(
    device: TcpDevice, replies: int, resets: bool, count: int
) -> None:
    device.resets, device.closes_after = resets, replies
    driver = driver_of(device)
    driver.open()
    got = []
    for first in range(0, count, 60):
        write_samples(device.registers, first, 60)
        got.append(read_all(driver).values[:, 0])
    driver.close()
    np.testing.assert_array_equal(np.concatenate(got), np.arange(count))
    assert driver.counts.faults == {}
    assert driver.counts.dropped == {}


def test_server_that_ends_every_connection_unanswered_costs_the_source_once(device: TcpDevice) -> None:
    driver = poller(device)
    driver.open()
    assert len(driver.read(0.0)) > 0
    device.closes_after = 0
    device.hang_up()
    before = device.connections
    with pytest.raises(DriverIOError, match=r"closed the connection|reset"):
        read_on(driver, 0.01)
    driver.close()
    assert device.connections == before + 1
    assert driver.counts.rejected == {"no answer": 1}
