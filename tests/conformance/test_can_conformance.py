from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cantools
import numpy as np

from drivers.can.driver import CanDriver, CanSettings
from drivers.conformance import DriverConformance, Line
from drivers.port import Driver, FloatArray, SourceRequest
from tests.conformance.socketcand_device import Socketcand

FOLDER = Path(__file__).parent
DATABASE: Any = cantools.database.load_file(FOLDER / "rig.dbc")


class DaemonLine(Line):
    """Samples in frames of one message, over socketcand."""

    driver_class = CanDriver
    protocol = "socketcand"
    fields: tuple[str, ...] = ("RIG_SAMPLE.Force", "RIG_SAMPLE.X1")
    counter = "RIG_SAMPLE.Counter"

    def __init__(self) -> None:
        self.daemon = Socketcand()
        self.daemon.start()
        self.played = 0

    def request(self) -> SourceRequest:
        settings = CanSettings(
            interface="socketcand",
            channel="can0",
            host="127.0.0.1",
            port=self.daemon.port,
            dbc=Path("rig.dbc"),
        )
        return SourceRequest("line", settings, self.fields, self.counter, FOLDER)

    def messages(self) -> list[str]:
        return list(dict.fromkeys(field.split(".")[0] for field in self.fields))

    def play(self, values: FloatArray) -> None:
        text = b""
        for row in values:
            for name in self.messages():
                text += self.frame(name, row)
            self.played += 1
        self.daemon.send(text)

    def frame(self, name: str, row: FloatArray) -> bytes:
        message = DATABASE.get_message_by_name(name)
        signals = {signal.name: signal.offset for signal in message.signals}
        signals["Counter"] = self.played % 2 ** message.get_signal_by_name("Counter").length
        signals.update(
            {f.split(".")[1]: row[i] for i, f in enumerate(self.fields) if f.startswith(name + ".")}
        )
        digits = f"{message.frame_id:08X}" if message.is_extended_frame else f"{message.frame_id:03X}"
        return f"< frame {digits} {self.played / 1000:.6f} {message.encode(signals).hex()} >".encode()

    def bad_requests(self) -> Sequence[Callable[[], SourceRequest]]:
        whole = self.request()
        fields = ["RIG_SAMPLE.Nosuch", "RIG_SAMPLE", "NOSUCH.Force"]
        return [
            *(lambda field=field: replace(whole, fields=(field,)) for field in fields),
            lambda: replace(whole, counter="RIG_SAMPLE.Nosuch"),
            lambda: replace(whole, counter=None, fields=("RIG_FORCE.Force", "RIG_MOVE.X1")),
            lambda: replace(whole, settings=whole.settings.model_copy(update={"dbc": Path("none.dbc")})),
            lambda: replace(whole, settings=whole.settings.model_copy(update={"dbc": Path("__init__.py")})),
        ]

    def attached(self, driver: Driver) -> None:
        self.daemon.wait_for_clients(1)

    def kill(self) -> None:
        self.daemon.stop()

    def restore(self) -> None:
        self.daemon.start()

    def written(self) -> Sequence[bytes]:
        return self.daemon.received

    def close(self) -> None:
        self.daemon.stop()


class FdLine(DaemonLine):
    """One FD frame of 16 bytes a sample, its counter wrapping after 256."""

    fields = ("RIG_FD.Force", "RIG_FD.X1")
    counter = "RIG_FD.Counter"


class JoinedLine(DaemonLine):
    """Samples in two messages, joined by their counters."""

    fields = ("RIG_FORCE.Force", "RIG_MOVE.X1", "RIG_MOVE.X2")
    counter = "RIG_FORCE.Counter"


class TestCanOneMessage(DriverConformance):
    def make_line(self) -> Line:
        return DaemonLine()

    def test_values_arrive_with_the_time_stamps_of_the_daemon(self) -> None:
        self.opened()
        self.line.play(self.samples(5))
        block = next(block for block in self.blocks(lambda: True) if len(block))
        assert block.t_ns is not None
        np.testing.assert_array_equal(block.t_ns, np.arange(5) * 1_000_000)


class TestCanFd(DriverConformance):
    def make_line(self) -> Line:
        return FdLine()


class TestCanJoined(DriverConformance):
    def make_line(self) -> Line:
        return JoinedLine()
