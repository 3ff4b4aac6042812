"""A serial adapter that writes frames as text (slcan), read by a parser of our own.

Nothing is written to it, unless open_adapter asks for it; then it is opened listen-only and closed at the
end.
"""

import re
from contextlib import suppress
from pathlib import Path

from drivers import clock
from drivers.can.bus.bus import BusKeys, CanBus
from drivers.can.bus.slcan_text import SlcanText
from drivers.can.codec.frames import Frames
from drivers.can.tuning import ADAPTER_ANSWER_S
from drivers.pipe import Pipe, serial_pipe
from drivers.port import Counts, DriverConfigError, DriverIOError
from drivers.serial_port import SerialKeys

BITRATES = {
    10_000: b"S0", 20_000: b"S1", 50_000: b"S2", 100_000: b"S3", 125_000: b"S4",
    250_000: b"S5", 500_000: b"S6", 800_000: b"S7", 1_000_000: b"S8",
}  # fmt: skip
_ANSWER = re.compile(rb"[\r\a]")


class SlcanBus(CanBus):
    """An open adapter.

    Args:
        keys: `channel` is the serial line, `baudrate` its speed; `bitrate` is the bus's, set with
            open_adapter.
        folder: relative lines start there.
        counts: told of lines that are no frame.

    Raises DriverIOError where there is no such line, or the adapter refuses to listen only; DriverConfigError
    for a bit rate that the protocol has no letter for.
    """

    def __init__(self, keys: BusKeys, folder: Path, counts: Counts) -> None:
        if keys.open_adapter and keys.bitrate not in BITRATES:
            known = ", ".join(map(str, BITRATES))
            raise DriverConfigError(f"open_adapter needs a bitrate that slcan has a code for: {known}")
        device = str(folder / keys.channel)
        line = SerialKeys(port=device, baudrate=keys.baudrate)
        self._opens = keys.open_adapter
        self._text = SlcanText(counts, fd=keys.fd)
        self._pipe: Pipe = serial_pipe(line, device, read_only=not keys.open_adapter)
        if keys.open_adapter:
            try:
                self._open_adapter(BITRATES[keys.bitrate or 0])
            except DriverIOError:
                self._pipe.close()
                raise

    def _open_adapter(self, speed: bytes) -> None:
        """Close the adapter's channel if it is open, set the bit rate, open it to listen only."""
        self._ask(b"C")
        self._ask(speed)
        if self._ask(b"L") == b"\a":
            raise DriverIOError(f"{self._pipe.name}: the adapter refuses to listen only (command L)")

    def _ask(self, command: bytes) -> bytes:
        """Return how the adapter answers a command: a carriage return, a bell, or nothing (some never do)."""
        self._pipe.send("slcan", command + b"\r")
        deadline = clock.monotonic() + ADAPTER_ANSWER_S
        while data := self._pipe.recv(deadline):
            if answer := _ANSWER.search(data):
                return answer[0]
        return b""

    def frames(self, deadline: float) -> Frames:
        data = self._pipe.recv(deadline)
        return self._text.feed(data, clock.monotonic_ns())

    def close(self) -> None:
        if self._opens:
            with suppress(DriverIOError):  # an adapter that is gone needs no closing
                self._pipe.send("slcan", b"C\r")
        self._pipe.close()
