import shutil
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import Empty, SimpleQueue

import numpy as np
from numpy.typing import NDArray

from drivers.conformance import DriverConformance, Line
from drivers.fields import ByteArray, Layout
from drivers.modbus.driver import ModbusDriver
from drivers.modbus.settings import ModbusSettings
from drivers.port import FloatArray, SourceRequest
from tests.conformance.modbus_device import Device, PtyDevice, Registers, TcpDevice

FIELDS = [
    {"name": "force", "type": "int32", "scale": 0.25},
    {"name": "x1", "type": "int16", "scale": 0.5},
    {"name": "x2", "type": "float32"},
]
SLOTS = 500


def registers_of(slots: ByteArray) -> NDArray[np.uint16]:
    """Slots (n, size) as register values, (n * size / 2,): what a device puts into its registers."""
    return np.ascontiguousarray(slots).reshape(-1).view(">u2").astype(np.uint16)


class RingLine(Line):
    """A ring of samples in a Modbus device."""

    driver_class = ModbusDriver
    outlives = SLOTS
    word_order = "big"

    def __init__(self) -> None:
        self.registers = Registers()
        self.played = 0
        self.folder = Path(tempfile.mkdtemp())
        self.device = self.make_device()
        self.device.start()
        self.show_index()

    def make_device(self) -> Device:
        self.protocol = "modbus-tcp"
        return TcpDevice(self.registers)

    def keys(self) -> dict[str, object]:
        assert isinstance(self.device, TcpDevice)
        return {"host": "127.0.0.1", "port": self.device.port}

    def settings(self) -> ModbusSettings:
        ring = {"address": 16, "slots": SLOTS}
        return ModbusSettings.model_validate(
            {
                "mode": "ring", "index": {"address": 2}, "ring": ring, "fields": FIELDS, "period_s": 0.002,
                "word_order": self.word_order, **self.keys(),
            }
        )  # fmt: skip

    def request(self) -> SourceRequest:
        return SourceRequest("line", self.settings(), ("force", "x1", "x2"))

    def show_index(self) -> None:
        raw = self.played % 2**32
        words = [raw >> 16, raw & 0xFFFF]
        self.registers.words[2:4] = words if self.word_order == "big" else words[::-1]

    def play(self, values: FloatArray) -> None:
        settings = self.settings()
        layout = Layout(settings.fields, "big", settings.word_order)
        raw = {f.name: values[:, i] / f.scale for i, f in enumerate(settings.fields)}
        words = registers_of(layout.pack({k: np.rint(v) if k != "x2" else v for k, v in raw.items()}))
        with self.registers.lock:
            for sample in words.reshape(len(values), -1):
                start = 16 + (self.played % 2**32) % SLOTS * len(sample)
                self.registers.words[start : start + len(sample)] = sample
                self.played += 1
            self.show_index()

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        fields = ("force", "x1", "x2")
        return [
            partial(SourceRequest, "line", self.settings(), fields, counter) for counter in ("x2", "none")
        ]

    def kill(self) -> None:
        self.device.stop()

    def restore(self) -> None:
        self.device.start()

    def written(self) -> Sequence[bytes]:
        return self.registers.requests

    def close(self) -> None:
        self.device.close()
        shutil.rmtree(self.folder)


class OwnLine(RingLine):
    """The same ring over a connection that no other source uses."""

    def keys(self) -> dict[str, object]:
        return {**super().keys(), "share": False}


class RtuLine(RingLine):
    """The same ring on a serial line, its words in the other order."""

    word_order = "little"

    def make_device(self) -> Device:
        self.protocol = "modbus-rtu"
        return PtyDevice(self.registers, self.folder / "line")

    def keys(self) -> dict[str, object]:
        return {"transport": "rtu", "port": "line"}

    def request(self) -> SourceRequest:
        return SourceRequest("line", self.settings(), ("force", "x1", "x2"), None, self.folder)


class FifoLine(RingLine):
    """A queue that reading does not empty, with a counter in each entry."""

    def settings(self) -> ModbusSettings:
        fields = [{"name": "n", "type": "uint16"}, *FIELDS]
        return ModbusSettings.model_validate(
            {"mode": "fifo", "address": 7, "fields": fields, "period_s": 0.001, **self.keys()}
        )

    def request(self) -> SourceRequest:
        return SourceRequest("line", self.settings(), ("force", "x1", "x2"), "n")

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        return ()

    def play(self, values: FloatArray) -> None:
        settings = self.settings()
        layout = Layout(settings.fields, "big", settings.word_order)
        for start in range(0, len(values), 5):
            part = values[start : start + 5]
            raw = {f.name: part[:, i] / f.scale for i, f in enumerate(settings.fields[1:])}
            raw["n"] = np.arange(self.played, self.played + len(part)) % 65536
            self.played += len(part)
            self.queue.put(registers_of(layout.pack(raw)).tolist())

    def make_device(self) -> Device:
        self.queue: SimpleQueue[list[int]] = SimpleQueue()
        self.registers.before_answer = self.next_entries
        return super().make_device()

    def next_entries(self, pdu: bytes) -> None:
        with suppress(Empty):
            self.registers.queues[7] = self.queue.get_nowait()


class TestModbusTcpRing(DriverConformance):
    def make_line(self) -> Line:
        return RingLine()


class TestModbusTcpRingUnshared(DriverConformance):
    def make_line(self) -> Line:
        return OwnLine()


class TestModbusRtuRing(DriverConformance):
    def make_line(self) -> Line:
        return RtuLine()


class TestModbusTcpFifo(DriverConformance):
    def make_line(self) -> Line:
        return FifoLine()
