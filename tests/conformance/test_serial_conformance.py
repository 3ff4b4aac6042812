import contextlib
import os
import pty
import shutil
import tempfile
import tty
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import sliplib
from cobs import cobs
from crccheck.crc import Crc16Ibm3740

from drivers.conformance import DriverConformance, Line
from drivers.fields import FieldSpec, Layout
from drivers.port import Driver, FloatArray, SourceRequest
from drivers.serial.driver import SerialDriver, SerialSettings

FIELDS = (
    FieldSpec(name="counter", type="uint8"),
    FieldSpec(name="force", type="int32", scale=0.25),
    FieldSpec(name="x1", type="int16", scale=0.5),
)


class BinaryLine(Line):
    """Frames on a pty, under a path that stays the same when it is unplugged and plugged."""

    driver_class = SerialDriver
    protocol = "serial"

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self.played = 0
        self.master = -1
        self.captured: list[bytes] = []
        self.restore()

    def keys(self) -> dict[str, Any]:
        return {"format": "binary", "sync": "AA55", "fields": FIELDS, "crc": "CRC-16/IBM-3740"}

    def request(self) -> SourceRequest:
        settings = SerialSettings.model_validate({"port": "line", **self.keys()})
        return SourceRequest("line", settings, ("force", "x1"), "counter", self.folder)

    def play(self, values: FloatArray) -> None:
        for row in values:
            self.send(self.frame(row))
            self.played += 1

    def frame(self, row: FloatArray) -> bytes:
        raw = {"counter": np.array([self.played % 256]), "force": row[:1] / 0.25, "x1": row[1:] / 0.5}
        body = Layout(FIELDS, "little").pack(raw).tobytes()
        return b"\xaa\x55" + body + Crc16Ibm3740.calc(body).to_bytes(2, "little")

    def send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.master, data) :]

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        return [lambda: replace(self.request(), counter="Nosuch")]

    def kill(self) -> None:
        if self.master >= 0:
            (self.folder / "line").unlink()
            os.close(self.slave)
            os.close(self.master)
            self.master = -1

    def restore(self) -> None:
        self.master, self.slave = pty.openpty()
        tty.setraw(self.slave)
        os.set_blocking(self.master, True)
        (self.folder / "line").symlink_to(os.ttyname(self.slave))

    def written(self) -> Sequence[bytes]:
        return self.captured

    def close(self) -> None:
        if self.master >= 0:
            os.set_blocking(self.master, False)
            with contextlib.suppress(BlockingIOError):
                self.captured.append(os.read(self.master, 4096))
        self.kill()
        shutil.rmtree(self.folder)


class TextLine(BinaryLine):
    """Lines of text with the checksum of NMEA 0183."""

    def keys(self) -> dict[str, Any]:
        columns = ["n", "force", "x1"]
        return {"format": "text", "columns": columns, "checksum": "nmea", "counter_modulus": 1000}

    def request(self) -> SourceRequest:
        return replace(super().request(), counter="n")

    def frame(self, row: FloatArray) -> bytes:
        body = f"RIG,{self.played % 1000},{float(row[0])!r},{float(row[1])!r}"
        check = int(np.bitwise_xor.reduce(np.frombuffer(body.encode(), np.uint8)))
        return f"${body}*{check:02X}\r\n".encode()


class EndedLine(BinaryLine):
    """The same frames, an end behind each, coded by packages of others."""

    framing = "cobs"

    def keys(self) -> dict[str, Any]:
        return {"format": "binary", "framing": self.framing, "fields": FIELDS, "crc": "CRC-16/IBM-3740"}

    def frame(self, row: FloatArray) -> bytes:
        frame = super().frame(row)[2:]
        return (
            cobs.encode(frame) + b"\0"
            if self.framing == "cobs"
            else b"\xc0" + sliplib.encode(frame) + b"\xc0"
        )


class SlipLine(EndedLine):
    framing = "slip"


class PatternLine(TextLine):
    """Lines for people, read by the named groups of an expression."""

    def keys(self) -> dict[str, Any]:
        pattern = r"#(?P<n>\d+) F=(?P<force>\S+) N, x=(?P<x1>\S+) mm(?:; .*)?"
        return {"format": "text", "pattern": pattern, "counter_modulus": 1000}

    def frame(self, row: FloatArray) -> bytes:
        return f"#{self.played % 1000} F={float(row[0])!r} N, x={float(row[1])!r} mm; ok\r\n".encode()

    def attached(self, driver: Driver) -> None:
        self.send(b"\r\n")  # what is amid a line when the port is opened is passed over


class TestSerialBinary(DriverConformance):
    def make_line(self) -> Line:
        return BinaryLine()


class TestSerialText(DriverConformance):
    def make_line(self) -> Line:
        return TextLine()


class TestSerialCobs(DriverConformance):
    def make_line(self) -> Line:
        return EndedLine()


class TestSerialSlip(DriverConformance):
    def make_line(self) -> Line:
        return SlipLine()


class TestSerialPattern(DriverConformance):
    def make_line(self) -> Line:
        return PatternLine()
