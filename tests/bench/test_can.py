"""What CAN costs: a frame of the kernel's bus, of a log, a line of an adapter, beside the library's way."""

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import can
import cantools
import numpy as np
import pytest
from can.interfaces.slcan import slcanBus

from drivers.can.bus.slcan_text import SlcanText
from drivers.can.codec.database import load, message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.can.codec.frames import FRAME, Frames
from drivers.can.log.driver import CanLogDriver, CanLogSettings
from drivers.port import Counts, SourceRequest
from tests.conformance.test_can_conformance import FOLDER
from tests.peers import ROOT
from tests.vcan import guest
from tests.vcan.test_vcan import kernel_has_vcan

pytestmark = [pytest.mark.bench, pytest.mark.realtime]
FIELDS = ("RIG_SAMPLE.Force", "RIG_SAMPLE.X1", "RIG_SAMPLE.X2")
COUNTER = "RIG_SAMPLE.Counter"


def least(line_lock: int, work: Callable[[], object]) -> float:
    """Return the shortest time of some turns, s."""
    found = float("inf")
    for _ in range(line_lock):
        begun = time.perf_counter()
        work()
        found = min(found, time.perf_counter() - begun)
    return found


def test_frame_of_the_kernels_bus_costs_a_fraction_of_the_librarys() -> None:
    command = [sys.executable, "-m", "tests.vcan.cost"]
    if kernel_has_vcan():
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=True)
        output = done.stdout
    else:
        status, output = guest.run(command, ROOT, 100.0)
        assert status == 0, output
    rows = [line.rsplit(" ", 2) for line in output.splitlines() if line[:3] in ("pyt", "one", "in ")]
    cost = {name: float(us) for name, _, us in rows}
    print("\nus a frame of the kernel's bus: " + ", ".join(f"{name} {us:.2f}" for name, us in cost.items()))
    assert cost["in batches, decoded to samples"] < 0.1 * cost["python-can"]
    assert cost["in batches"] < 0.3 * cost["one by one"]


def read_log(path: Path) -> int:
    settings = CanLogSettings(path=path, dbc=FOLDER / "rig.dbc")
    log = CanLogDriver(SourceRequest("log", settings, FIELDS, COUNTER))
    log.open()
    count = 0
    while True:
        try:
            count += len(log.read(0.0))
        except EOFError:
            return count


def test_log_of_candump_replays_at_300000_frames_a_second_and_more(tmp_path: Path) -> None:
    count, path = 500_000, tmp_path / "a.log"
    digits = np.random.default_rng(0).bytes(8 * count).hex().upper()
    path.write_text("".join(
        f"({1600000000 + i // 1000}.{i % 1000:03d}000) can0 100#{digits[16 * i : 16 * i + 16]}\n"
        for i in range(count)
    ))  # fmt: skip
    assert read_log(path) == count
    rate = count / least(3, lambda: read_log(path))
    short = tmp_path / "b.log"
    short.write_text("".join(path.read_text().splitlines(keepends=True)[:20_000]))
    library = 20_000 / least(3, lambda: sum(1 for _ in can.CanutilsLogReader(short)))
    print(
        f"\ncandump text: {rate:,.0f} frames a second to samples; python-can reads {library:,.0f} to messages"
    )
    assert rate >= 300_000


class Port:
    """A serial port of pyserial's shape that holds what it is given."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def in_waiting(self) -> int:
        return min(10, len(self._data) - self._at)

    def read(self, count: int) -> bytes:
        self._at += count
        return self._data[self._at - count : self._at]


def test_line_of_an_adapter_costs_a_fraction_of_the_librarys() -> None:
    stream = b"".join(b"t1008%016X\r" % number for number in range(5000))
    ours = least(5, lambda: SlcanText(Counts()).feed(stream, 0)) / 5000

    def library() -> None:
        bus = slcanBus.__new__(slcanBus)
        bus._queue, bus._buffer, bus.serialPortOrig = SimpleQueue(), bytearray(), Port(stream)
        for _ in range(5000):
            bus._recv_internal(1.0)

    theirs = least(3, library) / 5000
    print(
        f"\nslcan: {ours * 1e6:.2f} us a line; python-can's reader, the port's own cost apart, "
        f"{theirs * 1e6:.2f}"
    )
    assert ours < 0.5 * theirs


def test_batch_of_a_thousand_frames_is_decoded_50_times_cheaper_than_by_cantools() -> None:
    database: Any = cantools.database.load_file(FOLDER / "rig.dbc")
    table = np.zeros(1000, FRAME)
    table["id"], table["length"] = 0x100, 8
    table["data"][:, :8] = np.random.default_rng(1).integers(0, 256, (1000, 8), np.uint8)
    frames, datas = Frames(table, np.arange(1000)), [row.tobytes() for row in table["data"][:, :8]]
    codecs = message_codecs(load(FOLDER / "rig.dbc"), FIELDS, COUNTER)
    decoder = FrameDecoder(codecs, 3, Counts(), list[str]().append)
    message = database.get_message_by_name("RIG_SAMPLE")
    ours = least(50, lambda: decoder.decode(frames))
    theirs = least(5, lambda: [message.decode(data) for data in datas])
    print(
        f"\na thousand frames decoded: {ours * 1e6:.0f} us, "
        f"by cantools {theirs * 1e6:.0f} us: {theirs / ours:.0f} x"
    )
    assert theirs >= 50 * ours
