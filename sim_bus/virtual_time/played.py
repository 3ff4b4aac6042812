"""Sources on a machine whose time stops while nobody waits: the same devices, faults and bytes, no bus.

A driver that lives on it (`drivers.clock.playing`) opens its line, waits and reads as ever; a wait moves the
time to when something comes, or to its end. So what happens depends on configuration, scenario and seed
alone.
"""

import heapq
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from drivers.pipe import Pipe, PlayedMachine
from drivers.port import DriverIOError
from sim_bus.clock import PlayClock
from sim_bus.devices.can.socketcand import Session
from sim_bus.devices.modbus.answers import Answers
from sim_bus.devices.modbus.faults import Framing, ReplyFaults
from sim_bus.devices.modbus.units import Unit
from sim_bus.devices.stream import Outlet, Stream
from sim_bus.tuning import ANSWER_S, LEAD_NS, LISTEN_NS, START_NS


class PlayedTime:
    """The time of one source's machine, ns."""

    def __init__(self) -> None:
        self.now_ns = START_NS

    def __call__(self) -> int:
        return self.now_ns

    def begin(self) -> None:
        """Go back to when readers come."""
        self.now_ns = START_NS - LEAD_NS

    def pass_until(self, then_ns: int) -> None:
        """Let time go by."""
        self.now_ns = max(self.now_ns, then_ns)


class Line(ABC):
    """The device's end of a played line."""

    @abstractmethod
    def open(self, name: str) -> None:
        """Meet a reader; DriverIOError while there is nothing to be opened."""

    @abstractmethod
    def take_bytes(self, data: bytes) -> None:
        """Take what the reader wrote."""

    @abstractmethod
    def take(self) -> bytes:
        """Return what has come over the line by now; DriverIOError when the line went away."""

    @abstractmethod
    def next_ns(self) -> int:
        """Return when something may come next."""

    @abstractmethod
    def ledger(self) -> Mapping[str, dict[str, Any]]:
        """Return what was shown, by source."""


class PlayedPipe(Pipe):
    """The reader's end."""

    def __init__(self, name: str, line: Line, time: PlayedTime) -> None:
        self.name = name
        self._line = line
        self._time = time
        line.open(name)

    def fileno(self) -> int:
        raise DriverIOError(f"{self.name}: a played line has no descriptor")

    def send(self, protocol: str, data: bytes) -> None:
        self._line.take_bytes(data)

    def _read(self) -> bytes:
        return self._line.take()

    def recv(self, deadline: float) -> bytes:
        end = round(deadline * 1e9)
        while not (data := self._line.take()) and self._time.now_ns < end:
            self._time.pass_until(min(end, max(self._line.next_ns(), self._time.now_ns + 1)))
        return data

    def close(self) -> None:
        """Nothing holds the line."""


class Inbox(Outlet):
    """What was sent and waits for the reader."""

    def __init__(self) -> None:
        super().__init__()
        self.data = bytearray()

    def _send(self, data: bytes) -> int:
        self.data += data
        return len(data)


class _Called(Session):
    """A client of a played socketcand."""

    def __init__(self, stream: Stream, channel: str) -> None:
        super().__init__({channel: stream})
        self.data = bytearray()

    def _send(self, data: bytes) -> int:
        self.data += data
        return len(data)


class StreamLine(Line):
    """A line over which a device sends by itself.

    Args:
        stream: what it sends.
        clock: its clock.
        channel: the bus of a socketcand daemon; None for a serial line.
        greeting: what a serial line begins with.
    """

    def __init__(self, stream: Stream, clock: PlayClock, channel: str | None, greeting: bytes = b"") -> None:
        self._stream = stream
        self._clock = clock
        self._channel = channel
        self._greeting = greeting
        self._reader: Inbox | _Called | None = None

    def open(self, name: str) -> None:
        if self._reader is not None:
            self._reader.gone = True
        self._stream.step()
        if self._stream.disconnected:
            raise DriverIOError(
                f"{name}: No such file or directory" if self._channel is None else f"{name}: refused"
            )
        if self._channel is None:
            self._reader = Inbox()
            self._reader.put(self._greeting)
            self._stream.add(self._reader)
        else:
            self._reader = _Called(self._stream, self._channel)
            self._reader.greet()

    def take_bytes(self, data: bytes) -> None:
        if isinstance(self._reader, _Called):
            self._reader.take_bytes(data)

    def take(self) -> bytes:
        self._stream.step()
        if self._reader is None:
            raise DriverIOError("read before open")
        data, self._reader.data = bytes(self._reader.data), bytearray()
        self._reader.gone = self._stream.disconnected
        if self._reader.gone and not data:
            raise DriverIOError("the line was unplugged" if self._channel is None else "the device hung up")
        return data

    def next_ns(self) -> int:
        return self._stream.next_due_ns()

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        return {self._stream.source: {"bus": "played", **self._stream.ledger()}}


class ModbusLine(Line):
    """A line on which one unit answers."""

    def __init__(self, unit: Unit, time: PlayedTime, framing: Framing, seed: int) -> None:
        self._unit = unit
        self._time = time
        self._answers = Answers(unit, framing)
        self._faults = ReplyFaults(framing, unit.settings.timeout_s, seed)
        self._coming: list[tuple[int, int, bytes | None]] = []
        self._serial = framing == "rtu"
        self._opened = 0
        self._sent = 0

    def _gone(self) -> bool:
        return self._unit.has_fault("disconnect")

    def open(self, name: str) -> None:
        if self._gone():
            raise DriverIOError(
                f"{name}: {'No such file or directory' if self._serial else 'Connection refused'}"
            )
        if self._unit.has_fault("black-hole"):
            self._time.pass_until(self._time.now_ns + round(self._unit.settings.timeout_s * 1e9))
            raise DriverIOError(f"{name}: timed out")
        if not self._serial:
            self._coming.clear()
        self._opened = self._unit.newest()

    def take_bytes(self, data: bytes) -> None:
        adu = self._answers.reply(data)
        if adu is None:
            return
        for delay_s, piece in self._faults.deliveries(adu, self._unit.active_faults(self._opened)):
            self._sent += 1
            heapq.heappush(
                self._coming, (self._time.now_ns + round((ANSWER_S + delay_s) * 1e9), self._sent, piece)
            )

    def take(self) -> bytes:
        if self._gone() or self._unit.has_fault("accept-close"):
            raise DriverIOError("the device closed the connection")
        data = b""
        while self._coming and self._coming[0][0] <= self._time.now_ns:
            piece = self._coming[0][2]
            if not piece and data:
                break
            heapq.heappop(self._coming)
            data += _sent(piece)
        return data

    def next_ns(self) -> int:
        return self._coming[0][0] if self._coming else self._time.now_ns + LISTEN_NS

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        return {self._unit.source: {"bus": "played", **self._unit.ledger()}}


class PlayedSource(PlayedMachine):
    """The machine on which one source's driver lives.

    Args:
        time: its time.
        line: the one line that there is.
    """

    def __init__(self, time: PlayedTime, line: Line) -> None:
        self._time = time
        self._line = line

    def monotonic_ns(self) -> int:
        return self._time.now_ns

    def sleep(self, seconds: float) -> None:
        self._time.pass_until(self._time.now_ns + max(1, round(seconds * 1e9)))

    def tcp(self, host: str, port: int) -> Pipe:
        return PlayedPipe(f"{host}:{port}", self._line, self._time)

    def serial(self, device: str) -> Pipe:
        return PlayedPipe(device, self._line, self._time)


def _sent(piece: bytes | None) -> bytes:
    """Return what came over a connection; raises DriverIOError where nothing will come any more."""
    if piece is None:
        raise DriverIOError("Connection reset by peer")
    if not piece:
        raise DriverIOError("the device closed the connection")
    return piece
