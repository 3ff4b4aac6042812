"""Simulated serial devices: binary frames or text lines on a pseudo-terminal, sent at the samples' times."""

import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drivers import crc
from drivers.fields import Layout
from drivers.serial.driver import SerialSettings
from drivers.serial.framing import FRAMINGS
from sim_bus.clock import PlayClock
from sim_bus.devices import guard
from sim_bus.devices.device import Bench, Device
from sim_bus.devices.pty_line import PtyLine
from sim_bus.devices.stream import Outlet, Stream
from sim_bus.devices.wire import Pack, Raw, WireNumber, split
from sim_bus.errors import SimUsageError
from sim_bus.rig.rigfile import Source
from sim_bus.tuning import LINE_LOOK_S, SETTLE_S, STOP_S

ADDRESS = "DKSIM"
"""What stands between $ and the first cell of a line with an NMEA checksum."""


class PtyOutlet(Outlet):
    """A pseudo-terminal that somebody has open."""

    limit = 1 << 16

    def __init__(self, line: PtyLine) -> None:
        super().__init__()
        self._line = line

    def _send(self, data: bytes) -> int:
        return self._line.write(data)


class SerialDevice(Device):
    """One source on one line; a thread watches for readers and sends."""

    def __init__(self, clock: PlayClock, stream: Stream, line: PtyLine, greeting: bytes) -> None:
        super().__init__(clock)
        self._stream = stream
        self._line = line
        self._greeting = greeting
        self._outlet: PtyOutlet | None = None
        self._opened_at: float | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="serial device", daemon=True)

    def start(self) -> None:
        self._line.open()
        self._thread.start()

    def _run(self) -> None:
        while not self._stop.wait(min(self._stream.wait_s(), LINE_LOOK_S if self._outlet is None else 1.0)):
            self._watch_reader()
            self._stream.step()

    def _watch_reader(self) -> None:
        """Begin to send some time after the line was opened, and stop when it is closed."""
        self._plug(not self._stream.disconnected)
        if not self._line.is_open or not self._line.has_reader():
            self._hang_up()
            self._opened_at = None
        elif self._opened_at is None:
            self._opened_at = time.monotonic()
        elif self._outlet is None and self._may_send():
            self._outlet = PtyOutlet(self._line)
            self._outlet.put(self._greeting)
            self._stream.add(self._outlet)

    def _may_send(self) -> bool:
        """Tell whether the reader has had time to set up the line."""
        return self._opened_at is not None and time.monotonic() >= self._opened_at + SETTLE_S

    def _hang_up(self) -> None:
        """Send no more to this reader."""
        if self._outlet is not None:
            self._outlet.gone = True
        self._outlet = None

    def _plug(self, plugged: bool) -> None:
        if plugged and not self._line.is_open:
            self._line.open()
        elif not plugged:
            self._line.close()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(STOP_S)
        self._line.close()

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        return {self._stream.source: {"bus": f"serial {self._line.path}", **self._stream.ledger()}}


def binary_packer(settings: SerialSettings) -> Pack:
    """Return what makes frames: sync or coding and end, fields, check (low byte first, over the fields)."""
    layout = Layout(settings.fields, settings.byte_order)
    check = crc.by_name(settings.crc) if settings.crc else None
    sync = np.frombuffer(bytes.fromhex(settings.sync or ""), dtype=np.uint8)
    framing = FRAMINGS.get(settings.framing)

    def pack(raw: Raw) -> list[bytes]:
        body = layout.pack(raw)
        parts = [np.broadcast_to(sync, (len(body), len(sync))), body]
        if check is not None:
            parts.append(check.bytes_of(body))
        frames = np.hstack(parts)
        packed = split(frames.tobytes(), frames.shape[1])
        return packed if framing is None else [framing.encode(frame) + framing.end for frame in packed]

    return pack


def text_packer(settings: SerialSettings) -> Pack:
    """Return what makes lines: the columns, shortest round-trip digits; 0 where nobody fills one."""
    delimiter = settings.delimiter or ","
    nmea = settings.checksum == "nmea"

    def pack(raw: Raw) -> list[bytes]:
        columns = [raw[name].tolist() for name in settings.columns]
        lines = (delimiter.join(map(repr, cells)) for cells in zip(*columns, strict=True))
        return [(_nmea(f"{ADDRESS}{delimiter}{line}") if nmea else f"{line}\r\n").encode() for line in lines]

    return pack


def _nmea(body: str) -> str:
    check = 0
    for byte in body.encode():
        check ^= byte
    return f"${body}*{check:02X}\r\n"


def _text_numbers(settings: SerialSettings, source: Source) -> list[WireNumber]:
    """Return the columns: floats, but for the counter, which wraps where the settings say."""
    if settings.pattern is not None:
        raise SimUsageError(f'source "{source.name}": lines for a pattern cannot be made up; use columns')
    top = (settings.counter_modulus or 2**53) - 1
    return [
        WireNumber(name, 0, top) if name == source.counter else WireNumber(name, None, None)
        for name in settings.columns
    ]


def make_stream(bench: Bench, number: int) -> Stream:
    """Return what a serial source sends."""
    settings = bench.settings(SerialSettings, number)
    source = bench.source(number)
    faults = bench.faults(number)
    if settings.format == "text":
        numbers = _text_numbers(settings, source)
        pack = text_packer(settings)
    else:
        numbers = [
            WireNumber.of_type(field.name, field.type, field.scale, field.offset) for field in settings.fields
        ]
        pack = binary_packer(settings)
    return bench.stream(number, numbers, pack, lambda _index, row: row, faults)


def greeting(settings: SerialSettings) -> bytes:
    """Return what a line begins with: an empty line tells a reader of text that the next one is whole."""
    return b"\r\n" if settings.format == "text" else b""


def make_devices(bench: Bench, numbers: Sequence[int]) -> list[Device]:
    """Return a device for each serial source."""
    devices: list[Device] = []
    taken: set[Path] = set()
    for number in numbers:
        settings = bench.settings(SerialSettings, number)
        link = guard.pty_link(settings.port, bench.rig.folder, f"source[{number}].port")
        if link in taken:
            raise SimUsageError(
                f"source[{number}].port: {settings.port} is played for another source already"
            )
        taken.add(link)
        devices.append(
            SerialDevice(bench.clock, make_stream(bench, number), PtyLine(link), greeting(settings))
        )
    return devices
