"""What is tested where vcan0 exists; test_vcan.py starts it (its name keeps pytest from collecting it
elsewhere)."""

import itertools
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from drivers.can.codec.frames import candump_frames
from drivers.can.driver import CanDriver, CanSettings
from drivers.conformance import DriverConformance, Line
from drivers.port import FloatArray, SampleBlock, SourceRequest
from tests.conformance import test_can_conformance as can_lines

FOLDER = Path(can_lines.__file__).parent
DEADLINE_S = 20.0


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


def make_bus(bus: str = "vcan0") -> None:
    ip("add", "dev", bus, "type", "vcan")
    ip("set", bus, "up")


def bus_is_there(bus: str = "vcan0") -> bool:
    return bus in [name for _, name in socket.if_nameindex()]


def raw_socket(fd: bool = False, bus: str = "vcan0") -> socket.socket:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(fd))
    try:
        raw.bind((bus,))
    except OSError:
        raw.close()
        raise
    return raw


def request(
    *fields: str, counter: str = "RIG_SAMPLE.Counter", fd: bool = False, bus: str = "vcan0"
) -> SourceRequest:
    settings = CanSettings(interface="socketcan", channel=bus, dbc=Path("rig.dbc"), fd=fd)
    return SourceRequest("line", settings, fields or ("RIG_SAMPLE.Force", "RIG_SAMPLE.X1"), counter, FOLDER)


class KernelLine(can_lines.DaemonLine):
    """The same samples, as frames on the kernel's bus; all else on it was written by the driver."""

    protocol = "can"
    bus = "vcan0"

    def __init__(self) -> None:
        self.played = 0
        self.sent: set[bytes] = set()
        self.foreign: list[bytes] = []
        if not bus_is_there(self.bus):
            make_bus(self.bus)
        self.listen()

    def listen(self) -> None:
        self.sender, self.monitor = raw_socket(True, self.bus), raw_socket(True, self.bus)
        self.monitor.setblocking(False)

    def request(self) -> SourceRequest:
        return request(*self.fields, counter=self.counter, fd=True, bus=self.bus)

    def play(self, values: FloatArray) -> None:
        for row in values:
            for name in self.messages():
                self.send(self.frame(name, row))
            self.played += 1

    def send(self, text: bytes) -> None:
        _, _, digits, _, data, _ = text.decode().split()
        number = int(digits, 16) | (0x80000000 if len(digits) == 8 else 0)
        payload = bytes.fromhex(data)
        size = 64 if len(payload) > 8 else 8
        frame = struct.pack("=IB3x", number, len(payload)) + payload.ljust(size, b"\0")
        self.sent.add(frame)
        self.sender.send(frame)

    def attached(self, driver: object) -> None:
        pass

    def receive(self) -> None:
        """Take down what is on the bus and was not sent from here."""
        while True:
            try:
                frame = self.monitor.recv(72)
            except OSError:
                return
            if frame[:5] + b"\0" + frame[6:] not in self.sent:  # the kernel sets a flag in FD frames
                self.foreign.append(frame)

    def kill(self) -> None:
        self.receive()
        self.sender.close()
        self.monitor.close()
        ip("del", self.bus)

    def restore(self) -> None:
        self.sent.clear()
        make_bus(self.bus)
        self.listen()

    def written(self) -> Sequence[bytes]:
        return self.foreign

    def close(self) -> None:
        self.receive()
        self.sender.close()
        self.monitor.close()


class KernelFdLine(KernelLine):
    fields = can_lines.FdLine.fields
    counter = can_lines.FdLine.counter


class TestKernelBus(DriverConformance):
    def make_line(self) -> Line:
        return KernelLine()


class TestKernelBusFd(DriverConformance):
    def make_line(self) -> Line:
        return KernelFdLine()


@pytest.fixture
def driver() -> Iterator[CanDriver]:
    if not bus_is_there():
        make_bus()
    made = CanDriver(request())
    made.open()
    yield made
    made.close()


def collect(driver: CanDriver, wanted: int) -> SampleBlock:
    deadline = time.monotonic() + DEADLINE_S
    blocks: list[SampleBlock] = []
    while sum(map(len, blocks)) < wanted and time.monotonic() < deadline:
        blocks.append(driver.read(0.1))
    counters = [block.counter for block in blocks if block.counter is not None]
    times = [block.t_ns for block in blocks if block.t_ns is not None]
    values = np.concatenate([block.values for block in blocks])
    return SampleBlock(values, 0, np.concatenate(counters), np.concatenate(times))


def sample_frame(number: int) -> bytes:
    return struct.pack("=IB3x", 0x100, 8) + struct.pack("<HhhH", number % 65536, 0, number % 1000, 0)


def send_paced(count: int, period_s: float) -> None:
    """Send samples on a schedule that does not drift."""
    begun = time.monotonic()
    with raw_socket() as raw:
        for number in range(count):
            time.sleep(max(0.0, begun + number * period_s - time.monotonic()))
            raw.send(sample_frame(number))


def test_frames_of_cangen_arrive_as_candump_sees_them(driver: CanDriver) -> None:
    with subprocess.Popen(
        ["candump", "-L", "-n", "600", "vcan0"], stdout=subprocess.PIPE, text=True
    ) as watcher:
        subprocess.run(["cangen", "vcan0", "-I", "100", "-L", "8", "-g", "1", "-n", "600"], check=True)
        samples = collect(driver, 600)
        lines, _ = watcher.communicate(timeout=DEADLINE_S)
    seen, bad = candump_frames(lines.splitlines())
    assert not bad
    assert len(seen) == 600
    assert samples.counter is not None
    np.testing.assert_array_equal(samples.counter, seen.table["data"][:, :2].copy().view("<u2")[:, 0])
    force = seen.table["data"][:, 2:4].copy().view(">i2")[:, 0] * 0.25
    np.testing.assert_array_equal(samples.values[:, 0], force)
    assert samples.t_ns is not None
    np.testing.assert_allclose(
        samples.t_ns, seen.t_ns, atol=1000
    )  # candump prints microseconds of the same stamps


def test_log_played_by_canplayer_arrives_whole_and_in_order(driver: CanDriver, tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    frames = [sample_frame(number)[8:].hex().upper() for number in range(2000)]
    log.write_text("".join(f"(1.{i * 500:06d}) vcan0 100#{data}\n" for i, data in enumerate(frames)))
    subprocess.run(["canplayer", "-I", str(log)], check=True)
    samples = collect(driver, 2000)
    assert samples.counter is not None
    assert samples.counter.tolist() == list(range(2000))


def test_frames_at_one_kilohertz_for_three_seconds_arrive_without_loss(driver: CanDriver) -> None:
    sender = threading.Thread(target=send_paced, args=(3_000, 0.001))
    sender.start()
    samples = collect(driver, 3_000)
    sender.join()
    assert samples.counter is not None
    assert samples.counter.tolist() == list(range(3_000))
    assert driver.counts.received == 3_000
    assert not driver.counts.dropped


def test_filters_keep_foreign_frames_in_the_kernel(driver: CanDriver) -> None:
    with raw_socket() as raw:
        for number in range(50):
            raw.send(struct.pack("=IB3x8s", 0x101 + number, 8, bytes(8)))
        raw.send(sample_frame(7))
    assert driver._bus is not None
    frames = driver._bus.frames(time.monotonic() + DEADLINE_S)
    assert frames.table["id"].tolist() == [0x100]


def test_frames_that_the_kernel_drops_are_counted_to_the_last_one(driver: CanDriver) -> None:
    with raw_socket() as raw:
        for number in range(20_000):
            raw.send(sample_frame(number))
        got = drained(driver)
        raw.send(sample_frame(20_000))  # the count of the lost ones comes with the next frame
        got += drained(driver)
    assert driver.counts.dropped["kernel queue"] > 0
    assert got + driver.counts.dropped["kernel queue"] == 20_001


def drained(driver: CanDriver) -> int:
    return sum(map(len, itertools.takewhile(len, iter(lambda: driver.read(0.2), None))))
