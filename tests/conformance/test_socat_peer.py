"""Frames with ends over a serial line that socat plays: unplugged when it dies, found again when back."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import sliplib
from cobs import cobs
from crccheck.crc import Crc32

from drivers.port import DriverIOError, SourceRequest
from drivers.serial.driver import SerialDriver, SerialSettings
from tests import peers

FIELDS = [{"name": "n", "type": "uint16"}, {"name": "a", "type": "int32"}]
CODED = {"cobs": lambda body: cobs.encode(body) + b"\0", "slip": lambda body: sliplib.encode(body) + b"\xc0"}


@contextmanager
def line(folder: Path) -> Iterator[int]:
    """Join two ptys by socat; yield the device's end, open for writing."""
    socat = peers.program("socat", "socat")
    ends = [f"pty,rawer,link={folder / name}" for name in ("device", "reader")]
    with subprocess.Popen([socat, "-d", "-d", *ends], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        while "starting data transfer" not in process.stderr.readline():
            assert process.poll() is None
        descriptor = os.open(folder / "device", os.O_WRONLY | os.O_NOCTTY)
        try:
            yield descriptor
        finally:
            os.close(descriptor)
            process.kill()


@pytest.mark.parametrize("framing", sorted(CODED))
def test_frames_over_socat_are_read_and_so_are_those_after_it_came_back(tmp_path: Path, framing: str) -> None:
    keys = {"format": "binary", "framing": framing, "fields": FIELDS, "crc": "CRC-32/ISO-HDLC"}
    settings = SerialSettings.model_validate({"port": "reader", **keys})
    driver = SerialDriver(SourceRequest("line", settings, ("a",), "n", tmp_path))
    for round_ in range(2):
        with line(tmp_path) as device:
            driver.open()
            for n in range(50):
                body = n.to_bytes(2, "little") + (-n - round_).to_bytes(4, "little", signed=True)
                os.write(device, CODED[framing](body + Crc32.calc(body).to_bytes(4, "little")))
            values: list[float] = []
            while len(values) < 50:
                values += driver.read(5.0).values[:, 0].tolist()
            assert values == [float(-n - round_) for n in range(50)]
        with pytest.raises(DriverIOError):
            read_until_gone(driver)
        driver.close()
    assert driver.counts.received == 100
    assert driver.counts.rejected.total() == 0


def read_until_gone(driver: SerialDriver) -> None:
    for _ in range(200):
        driver.read(0.1)
