"""Many frames by one system call, held frame by frame against one by one, on the kernel's virtual bus."""

import itertools
import struct
import time
from collections.abc import Iterator

import numpy as np
import pytest

from drivers.can.bus import kernel as can_kernel
from drivers.can.bus.batch import BatchReceiver
from drivers.can.bus.bus import BusKeys
from drivers.can.bus.kernel import KernelBus
from drivers.can.codec.frames import EXTENDED, REMOTE, Frames, joined, no_frames
from drivers.port import Counts, DriverIOError
from tests.vcan.inside import DEADLINE_S, bus_is_there, ip, make_bus, raw_socket

ALL = ((0, 0),)
KEYS = BusKeys(interface="socketcan", channel="vcan0", fd=True)


@pytest.fixture
def buses() -> Iterator[tuple[KernelBus, KernelBus]]:
    """The same bus, read in batches and frame by frame."""
    if not bus_is_there():
        make_bus()
    fast, plain = (KernelBus(KEYS, ALL, Counts(), batched=batched) for batched in (True, False))
    assert fast._receiver is not None
    assert plain._receiver is None
    yield fast, plain
    fast.close()
    plain.close()


def random_frame(rng: np.random.Generator) -> bytes:
    """A frame of any kind: both identifiers, every length, FD, remote, error."""
    number = int(rng.integers(1 << 29)) | EXTENDED if rng.random() < 0.5 else int(rng.integers(1 << 11))
    kind = rng.random()
    if kind < 0.4:
        size = int(rng.choice([0, 1, 8, 12, 20, 48, 64]))
        return struct.pack("=IBB2x", number, size, int(rng.integers(4))) + rng.bytes(size).ljust(64, b"\0")
    if kind < 0.5:
        return struct.pack("=IB3x8x", number | REMOTE, int(rng.integers(9)))
    if kind < 0.6:
        return struct.pack("=IB3x", 0x20000000 | int(rng.integers(1, 512)), 8) + rng.bytes(8)
    size = int(rng.integers(9))
    return struct.pack("=IB3x", number, size) + rng.bytes(size).ljust(8, b"\0")


def drained(bus: KernelBus, count: int) -> Frames:
    deadline = time.monotonic() + DEADLINE_S
    frames = no_frames()
    while len(frames) < count and time.monotonic() < deadline:
        frames = joined(frames, bus.frames(time.monotonic() + 0.2))
    return frames


def assert_same(fast: Frames, plain: Frames, count: int) -> None:
    assert len(fast) == len(plain) == count
    assert [row.tobytes() for row in fast.table] == [row.tobytes() for row in plain.table]
    assert fast.t_ns.tolist() == plain.t_ns.tolist()
    assert (np.diff(fast.t_ns) >= 0).all()
    assert abs(int(fast.t_ns[-1]) - time.time_ns()) < 60e9


def test_frames_of_every_kind_are_the_same_in_batches_as_one_by_one(
    buses: tuple[KernelBus, KernelBus],
) -> None:
    rng = np.random.default_rng(3)
    sizes = [1, 2, 600, 1023, 1024, 1025, 3, 700]
    with raw_socket(fd=True) as sender:
        for size in sizes:
            for _ in range(size):
                sender.send(random_frame(rng))
            assert_same(drained(buses[0], size), drained(buses[1], size), size)


def test_table_given_out_is_not_written_again(buses: tuple[KernelBus, KernelBus]) -> None:
    with raw_socket(fd=True) as sender:
        sender.send(struct.pack("=IBB2x", 0x123, 64, 0) + b"\xaa" * 64)
        first = drained(buses[0], 1)
        kept = first.table[0].tobytes()
        sender.send(struct.pack("=IB3x8s", 0x124, 2, b"\xbb\xcc"))
        second = drained(buses[0], 1)
    assert first.table[0].tobytes() == kept
    assert second.table[0].tobytes() == struct.pack("=IB3x2s", 0x124, 2, b"\xbb\xcc") + bytes(70)


def test_frames_that_the_kernel_loses_are_counted_to_the_last_one_either_way(
    buses: tuple[KernelBus, KernelBus],
) -> None:
    with raw_socket(fd=True) as sender:
        for number in range(12_000):
            sender.send(struct.pack("=IB3x8x", number % 2048, 8))
        got = [len(until_quiet(bus)) for bus in buses]
        for _ in range(3):
            sender.send(struct.pack("=IB3x8x", 1, 8))  # the count of the lost ones comes with the next frame
        got = [count + len(until_quiet(bus)) for count, bus in zip(got, buses, strict=True)]
    for count, bus in zip(got, buses, strict=True):
        assert bus._counts.dropped["kernel queue"] > 1000
        assert count + bus._counts.dropped["kernel queue"] == 12_003


def until_quiet(bus: KernelBus) -> Frames:
    pieces = itertools.takewhile(len, iter(lambda: bus.frames(time.monotonic() + 0.2), None))
    frames = no_frames()
    for piece in pieces:
        frames = joined(frames, piece)
    return frames


@pytest.mark.parametrize("batched", [True, False], ids=["in batches", "one by one"])
def test_frames_before_an_interface_goes_down_come_out_before_the_failure(batched: bool) -> None:
    if not bus_is_there():
        make_bus()
    bus = KernelBus(KEYS, ALL, Counts(), batched=batched)
    with raw_socket(fd=True) as sender:
        for number in range(10):
            sender.send(struct.pack("=IB3x8x", number, 8))
    ip("set", "vcan0", "down")
    got = drain_to_failure(bus)
    bus.close()
    ip("set", "vcan0", "up")
    assert got in (0, 10)  # the kernel tells of the failure first: then nothing can be said of what waited


def drain_to_failure(bus: KernelBus) -> int:
    """Return how many frames came before the bus failed."""
    got: list[int] = []

    def read_on() -> None:
        deadline = time.monotonic() + DEADLINE_S
        while time.monotonic() < deadline:
            got.append(len(bus.frames(time.monotonic() + 0.1)))

    with pytest.raises(DriverIOError, match="vcan0: Network is down"):
        read_on()
    return sum(got)


def test_machine_without_the_system_call_reads_frame_by_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    if not bus_is_there():
        make_bus()
    monkeypatch.setattr(can_kernel, "batches_work", lambda: False)
    bus = KernelBus(KEYS, ALL, Counts())
    assert bus._receiver is None
    with raw_socket(fd=True) as sender:
        sender.send(struct.pack("=IB3x8x", 7, 8))
    assert drained(bus, 1).table["id"].tolist() == [7]
    bus.close()


def test_receiver_without_its_socket_says_so(buses: tuple[KernelBus, KernelBus]) -> None:
    receiver = BatchReceiver(buses[0]._socket.fileno())
    receiver._descriptor = 9999
    with pytest.raises(OSError, match="Bad file descriptor"):
        receiver.receive()
