"""The suite for what came after: slcan adapters, multiplexed pages, checksums and counters that skip a
number."""

import contextlib
import os
import shutil
import tempfile
import tty
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.can.codec.frames import FD_LENGTHS
from drivers.can.driver import CanDriver, CanSettings
from drivers.conformance import DriverConformance, Line
from drivers.port import Driver, FloatArray, SourceRequest
from tests.conformance.socketcand_device import Socketcand
from tests.conformance.test_can_conformance import DATABASE, FOLDER, DaemonLine, FdLine


class SlcanLine(DaemonLine):
    """The same samples behind an adapter on a pseudo-terminal, whose path stays the same when it is
    replugged."""

    protocol = "slcan"
    fd = False

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp())
        self.played = 0
        self.captured: list[bytes] = []
        self.restore()

    def request(self) -> SourceRequest:
        port = str(self.folder / "line")
        settings = CanSettings(interface="slcan", channel=port, dbc=Path("rig.dbc"), fd=self.fd)
        return SourceRequest("line", settings, self.fields, self.counter, FOLDER)

    def play(self, values: FloatArray) -> None:
        for row in values:
            for name in self.messages():
                self.send(self.line(name, row))
            self.played += 1

    def line(self, name: str, row: FloatArray) -> bytes:
        _, _, digits, _, data, _ = self.frame(name, row).decode().split()
        letter = ("D" if len(digits) == 8 else "d") if len(data) > 16 else "T" if len(digits) == 8 else "t"
        return f"{letter}{digits}{FD_LENGTHS.index(len(data) // 2):X}{data.upper()}\r".encode()

    def send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self.master, data) :]

    def attached(self, driver: Driver) -> None:
        self.send(b"\r")  # an adapter's last line ended some time ago

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        return ()

    def kill(self) -> None:
        if self.master >= 0:
            (self.folder / "line").unlink()
            os.close(self.slave)
            os.close(self.master)
            self.master = -1

    def restore(self) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
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


class SlcanFdLine(SlcanLine):
    fields, counter, fd = FdLine.fields, FdLine.counter, True


class CheckedLine(DaemonLine):
    """Frames with a sum of their bytes, and a counter that goes from 14 to 0."""

    fields = ("RIG_CHECKED.Force", "RIG_CHECKED.X1")
    counter = "RIG_CHECKED.Counter"
    modulus = 15

    def request(self) -> SourceRequest:
        whole = super().request()
        check = {"signal": "Sum", "method": "sum"}
        return replace(
            whole, settings=with_keys(whole.settings, counter_modulus=self.modulus, checksum=check)
        )

    def frame(self, name: str, row: FloatArray) -> bytes:
        data = bytearray(DATABASE.encode_message(name, {
            "Counter": self.played % self.modulus, "Force": row[self.place("Force")],
            "X1": row[self.place("X1")],
            "Sum": 0,
        }))  # fmt: skip
        data[7] = sum(data) % 256
        return f"< frame 105 {self.played / 1000:.6f} {data.hex()} >".encode()

    def place(self, signal: str) -> int:
        return [field.split(".")[1] for field in self.fields].index(signal)

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        whole = self.request()
        wrong = [{"signal": "Nosuch", "method": "sum"}, {"signal": "Force", "method": "xor"}]
        return [
            lambda check=check: replace(whole, settings=with_keys(whole.settings, checksum=check))
            for check in wrong
        ]


class PagedLine(DaemonLine):
    """Force and displacement on two pages of one message, joined by the counter."""

    fields = ("RIG_PAGES.Force", "RIG_PAGES.X1")
    counter = "RIG_PAGES.Counter"

    def play(self, values: FloatArray) -> None:
        text = b""
        for row in values:
            for which, signal in enumerate(("Force", "X1")):
                data = DATABASE.encode_message("RIG_PAGES", {
                    "Which": which, "Counter": self.played % 256,
                    signal: row[[field.split(".")[1] for field in self.fields].index(signal)],
                })  # fmt: skip
                text += f"< frame 107 {self.played / 1000:.6f} {data.hex()} >".encode()
            self.played += 1
        self.daemon.send(text)

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        return ()


def with_keys(settings: CanSettings, **keys: Any) -> CanSettings:
    return CanSettings.model_validate(settings.model_dump() | keys)


class TestSlcan(DriverConformance):
    def make_line(self) -> Line:
        return SlcanLine()


class TestSlcanFd(DriverConformance):
    def make_line(self) -> Line:
        return SlcanFdLine()


class TestCanChecked(DriverConformance):
    def make_line(self) -> Line:
        return CheckedLine()


class TestCanPages(DriverConformance):
    def make_line(self) -> Line:
        return PagedLine()


def test_frames_of_several_samples_arrive_as_samples_with_times_of_their_own() -> None:
    """Lines of the suite play any number of samples; these come by fours."""
    daemon = Socketcand()
    daemon.start()
    settings = CanSettings(
        interface="socketcand", channel="can0", port=daemon.port, dbc=Path("rig.dbc"), samples_per_frame=4,
        sample_period_s=0.001,
    )  # fmt: skip
    driver = CanDriver(
        SourceRequest("line", settings, ("RIG_BLOCK.X1_0", "RIG_BLOCK.Force_0"), "RIG_BLOCK.Counter", FOLDER)
    )
    assert driver.resolution() == (0.5, 0.001)
    driver.open()
    daemon.wait_for_clients(1)
    played = np.random.default_rng(1).integers(-1000, 1000, (400, 2)) * (0.5, 0.001)
    for first in range(0, 400, 4):
        signals = {
            f"{name}_{i}": played[first + i, k] for i in range(4) for k, name in enumerate(("X1", "Force"))
        }
        data = DATABASE.encode_message(
            "RIG_BLOCK", {"Counter": 65500 + first - 65536 * (first > 32), **signals}
        )
        daemon.send(f"< frame 106 {(first + 3) / 1000:.6f} {data.ljust(32, bytes(1)).hex()} >".encode())
    blocks = [driver.read(1.0)]
    while sum(map(len, blocks)) < 400 and len(blocks) < 40:
        blocks.append(driver.read(1.0))
    driver.close()
    daemon.stop()
    np.testing.assert_allclose(np.concatenate([block.values for block in blocks]), played, rtol=1e-12)
    counters = np.concatenate([block.counter for block in blocks if block.counter is not None])
    assert counters.tolist() == [(65500 + n) % 65536 for n in range(400)]
    times = np.concatenate([block.t_ns for block in blocks if block.t_ns is not None])
    assert times.tolist() == [n * 1_000_000 for n in range(400)]
