"""Many units on one line: everybody's share of it, and what a silent one costs the others."""

import json
import random
import struct
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers import clock
from drivers.modbus.driver import ModbusDriver
from drivers.modbus.settings import ModbusSettings
from drivers.port import SourceRequest
from tests import figures
from tests.conformance.modbus_device import PtyDevice, Registers, crc16
from tests.links import NotedLink
from tests.ports import free_port
from tests.sim.rigs import MODEL, simulator
from tests.unit.drivers.modbus.test_line import numbers, rtu, tcp
from tests.unit.drivers.played_line import PlayedLine

UNITS = range(1, 9)
RTU = {"transport": "rtu", "port": "/line", "baudrate": 115200}
PERIOD_S = 0.1


def source(unit: int, folder: Path = Path(), **keys: object) -> ModbusDriver:
    field = {"name": "a", "type": "uint16", "address": 40 + unit}
    settings = ModbusSettings.model_validate({"mode": "poll", "device_id": unit, "fields": [field], **keys})
    return ModbusDriver(SourceRequest(f"unit{unit}", settings, ("a",), None, folder))


class Rig:
    """Eight units of a played line, each read as soon as it is due; one of them can be silent."""

    def __init__(self, line: PlayedLine, **keys: object) -> None:
        self.line = line
        self.links = [
            NotedLink(source(unit, period_s=PERIOD_S, **keys), 3600.0, rng=random.Random(unit))
            for unit in UNITS
        ]
        self.samples = [0] * len(self.links)
        self.events: list[list[str]] = [[] for _ in self.links]

    def run(self, seconds: float) -> list[int]:
        """Let time go by; return how many samples each unit delivered in it."""
        before, end = list(self.samples), clock.monotonic() + seconds
        while clock.monotonic() < end:
            for number, link in enumerate(self.links):
                self.samples[number] += len(link.read(0.0))
                self.events[number] += [event.cause for event in link.take_events()]
            clock.sleep(0.002)
        return [now - then for now, then in zip(self.samples, before, strict=True)]

    def seconds_until_sample(self, number: int) -> float:
        begun = clock.monotonic()
        while not self.run(0.01)[number]:
            assert clock.monotonic() < begun + 20.0
        return clock.monotonic() - begun


def wire(silent: set[int]) -> PlayedLine:
    return PlayedLine(lambda q: (b"", 0.0) if q[0] in silent else (rtu(q[0], numbers(q[1:-2])), 0.004))


def gateway(silent: set[int], gives_up_s: float) -> PlayedLine:
    """A silent unit is answered for with exception 11, after a while in which nobody else is answered."""

    def answer(request: bytes) -> tuple[bytes, float]:
        if request[6] in silent:
            return tcp(request, struct.pack("BB", request[7] | 0x80, 11)), gives_up_s
        return tcp(request, numbers(request[7:])), 0.004

    return PlayedLine(answer)


# a gateway answers nobody while it waits for the silent unit by itself: 0.15 s here, longer than a period
@pytest.mark.parametrize(
    ("name", "keys", "kept"),
    [("wire", {**RTU, "timeout_s": 0.2}, 0.99), ("gateway", {"timeout_s": 0.5}, 0.99)],
)
def test_silent_unit_leaves_the_others_their_rate_and_is_back_in_time(
    name: str, keys: dict[str, object], kept: float
) -> None:
    silent: set[int] = set()
    line = wire(silent) if name == "wire" else gateway(silent, 0.15)
    with clock.playing(line):
        rig = Rig(line, **keys)
        rig.run(1.0)
        silent.add(3)
        counts = rig.run(30.0)
        silent.clear()
        back_s = rig.seconds_until_sample(2)
        for link in rig.links:
            link.close()
    others = [count for number, count in enumerate(counts) if number != 2]
    figures.figure(
        f"1 of 8 Modbus units silent ({name}): the others keep {min(others)} of 300 polls, "
        f"it is back in {back_s:.2f} s"
    )
    assert min(others) >= 0.99 * 300
    assert counts[2] == 0
    assert back_s <= 2.0
    assert rig.events == [["lost", "recovered"] if number == 2 else [] for number in range(8)]
    assert [bool(link.driver.counts.faults) for link in rig.links] == [number == 2 for number in range(8)]
    assert line.connections <= 2


class Units(PtyDevice):
    """Units that share a real line, each answer of which takes its time."""

    def __init__(self, link: Path, answer_s: float) -> None:
        super().__init__(Registers(), link)
        self._answer_s = answer_s
        self._pace = threading.Event()

    def _reply(self, frame: bytes) -> bytes:
        self._pace.wait(self._answer_s)
        reply = frame[:1] + self.registers.answer(frame[1:-2])
        return reply + crc16(reply)


class Poller:
    """One unit, polled by a thread of its own as the agent does."""

    def __init__(self, driver: ModbusDriver) -> None:
        self.samples = 0
        self._stop = threading.Event()
        self._link = NotedLink(driver, 3600.0, stop=self._stop)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._stop.is_set():
            self.samples += len(self._link.read(0.1))
        self._link.close()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()


@contextmanager
def polled(drivers: Sequence[ModbusDriver]) -> Iterator[list[Poller]]:
    pollers = [Poller(driver) for driver in drivers]
    try:
        yield pollers
    finally:
        for poller in pollers:
            poller.stop()


@pytest.mark.realtime
def test_line_that_cannot_keep_up_is_shared_evenly(tmp_path: Path) -> None:
    device = Units(tmp_path / "line", answer_s=0.003)
    device.start()
    keys = {**RTU, "port": "line", "timeout_s": 2.0, "period_s": 0.005}
    waiting = threading.Event()
    with polled([source(unit, tmp_path, **keys) for unit in UNITS]) as pollers:
        deadline = time.monotonic() + 20.0
        while min(poller.samples for poller in pollers) < 20:
            assert time.monotonic() < deadline
            waiting.wait(0.01)
        counts = [poller.samples for poller in pollers]
    device.close()
    figures.figure(
        "8 Modbus units ask for many times what their line carries: "
        f"{min(counts)} to {max(counts)} polls each"
    )
    assert min(counts) >= 0.8 * max(counts)


TWO_RINGS = """
[[source]]
name = "{name}"
driver = "modbus"
device_id = {unit}
{where}
mode = "ring"
index = {{ address = 0, type = "uint32" }}
ring = {{ address = 16, slots = 4096 }}
fields = [{fields}]
map = {{ {map} }}
"""


@pytest.mark.realtime
@pytest.mark.parametrize("transport", ["rtu", "tcp"])
def test_two_rings_of_a_simulated_line_are_read_whole_side_by_side(tmp_path: Path, transport: str) -> None:
    port = "line" if transport == "rtu" else free_port()
    keys: dict[str, object] = {"transport": transport, "port": port, "baudrate": 921600}
    where = "\n".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
    parts = {1: ("F", "force = 'F'"), 2: ("X1", "x1 = 'X1'")}
    text = MODEL.format(rate=1000.0) + "".join(
        TWO_RINGS.format(
            name=f"unit{unit}",
            unit=unit,
            where=where,
            map=map_,
            fields=f'{{ name = "{name}", type = "float32" }}',
        )
        for unit, (name, map_) in parts.items()
    )
    ring = {
        "mode": "ring",
        "index": {"address": 0},
        "ring": {"address": 16, "slots": 4096},
        "timeout_s": 2.0,
        **keys,
    }
    with simulator(tmp_path, text.replace("'", '"'), "--scenario", "default") as sim:
        drivers = []
        for unit, (name, _) in parts.items():
            fields = [{"name": name, "type": "float32"}]
            settings = ModbusSettings.model_validate({**ring, "device_id": unit, "fields": fields})
            drivers.append(ModbusDriver(SourceRequest(f"unit{unit}", settings, (name,), None, tmp_path)))
        with ThreadPoolExecutor(2) as pool:
            values = list(pool.map(lambda driver: read_ring(driver, 500), drivers))
        assert sim.stop() == 0
    readings = sim.truth()["readings"]
    for column, got in enumerate(values):
        np.testing.assert_allclose(got, readings[: len(got), column], rtol=1e-6, atol=1e-12)


def read_ring(driver: ModbusDriver, count: int) -> list[float]:
    """Return the first samples of a ring, whose numbers must follow each other."""
    values: list[float] = []
    driver.open()
    deadline = time.monotonic() + 20.0
    while len(values) < count:
        assert time.monotonic() < deadline, len(values)
        block = driver.read(0.1)
        if len(block):
            assert block.counter is not None
            np.testing.assert_array_equal(block.counter, np.arange(len(values), len(values) + len(block)))
            values += block.values[:, 0].tolist()
    driver.close()
    return values
