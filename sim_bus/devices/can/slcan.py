"""A simulated slcan adapter: frames as lines of text on a pseudo-terminal, answers to what opens its channel.

Its channel is open from the start, as of adapters that were set up so; C closes it, L and O open it.
"""

from collections.abc import Sequence

from sim_bus.clock import PlayClock
from sim_bus.devices.can.packing import FrameKind
from sim_bus.devices.pty_line import PtyLine
from sim_bus.devices.serial_device import SerialDevice
from sim_bus.devices.stream import Stream

_SIZES = (*range(9), 12, 16, 20, 24, 32, 48, 64)
_LETTERS = {(False, False): b"t", (True, False): b"T", (False, True): b"d", (True, True): b"D"}
_WRAP_MS = 60_000  # fixed by LAWICEL CAN232
GREETING = b"\r"
_CROWDS = {"foreign": 1, "flood": 100}
_FOREIGN = b"t7E580000000000000000\r"
_STATES = {"error-warning": b"sw100020\r", "error-passive": b"sp128040\r", "bus-off": b"sb255255\r"}
_SOUND, _OVERRUN, _BUS_ERROR = b"sa000000\r", b"F08\r", b"F80\r"


class SlcanText:
    """Frames of one sample as an adapter writes them.

    Args:
        kinds: the frames of a sample.
        sample_rate_hz: for the time stamps.
        stamped: whether lines end in milliseconds (the adapter's Z1).
    """

    def __init__(self, kinds: Sequence[FrameKind], sample_rate_hz: float, *, stamped: bool = False) -> None:
        self._heads = [
            (b"%s%s%X"
             % (_LETTERS[kind.extended, kind.fd and kind.size > 8], kind.digits, _SIZES.index(kind.size)),
             kind.size) for kind in kinds
        ]  # fmt: skip
        self._period_ms = 1000.0 / sample_rate_hz
        self._stamped = stamped

    def __call__(self, index: int, row: bytes) -> bytes:
        if not row:
            return b""  # the sample goes out with a later one
        stamp = b"%04X" % (int(index * self._period_ms) % _WRAP_MS) if self._stamped else b""
        out = []
        for head, size in self._heads:
            data, row = row[:size], row[size:]
            out.append(b"%s%s%s\r" % (head, data.hex().upper().encode(), stamp))
        return b"".join(out)

    def strange(self, name: str, since: int, text: bytes) -> bytes:
        """Return the sample's text with what a fault sends besides it, or instead of it."""
        if name == "overrun":
            return _OVERRUN
        if name in _STATES:
            state = {0: _STATES[name], -1: _SOUND}.get(since, b"")
            return state if name == "bus-off" else state + text
        if name == "dlc":
            head, size = self._heads[0]
            return (
                head[:-1]
                + b"%X" % (_SIZES.index(size) - 1)
                + text[len(head) : len(head) + 2 * (size - 1)]
                + b"\r"
            )
        return self._beside(name) + text

    def _beside(self, name: str) -> bytes:
        """Return what comes before the sample."""
        head, size = self._heads[0]
        if name == "error-frame":
            return _BUS_ERROR
        if name == "remote":
            return b"%s%s%X\r" % (head[:1].replace(b"t", b"r").replace(b"T", b"R"), head[1:-1], min(size, 8))
        if name == "extended":
            return b"T%s8%s\r" % (head[1:-1].rjust(8, b"0"), bytes(8).hex().encode())
        return _FOREIGN * _CROWDS[name]


class SlcanDevice(SerialDevice):
    """One source behind an adapter.

    Attributes:
        asked: the commands that came, whole ones, in order.
    """

    def __init__(self, clock: PlayClock, stream: Stream, line: PtyLine) -> None:
        super().__init__(clock, stream, line, GREETING)
        self.asked: list[bytes] = []
        self._open = True
        self._input = b""

    def _watch_reader(self) -> None:
        super()._watch_reader()
        if self._line.is_open and self._line.has_reader():
            self._input = (self._input + self._line.read())[-256:]
        while b"\r" in self._input:
            command, _, self._input = self._input.partition(b"\r")
            self._carry_out(command)

    def _may_send(self) -> bool:
        return self._open and super()._may_send()

    def _carry_out(self, command: bytes) -> None:
        self.asked.append(command)
        known = command[:1] in (b"C", b"S", b"L", b"O", b"Z")
        if command in (b"L", b"O"):
            self._open = True
        elif command == b"C":
            self._open = False
            self._hang_up()
        self._line.write(b"\r" if known else b"\a", 0.1)
