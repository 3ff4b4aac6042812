"""A socketcand daemon on loopback: serves simulated CAN buses in raw mode, many buses and clients at once."""

import re
import selectors
import socket
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sim_bus.clock import PlayClock
from sim_bus.devices.can.packing import FrameKind
from sim_bus.devices.device import Device
from sim_bus.devices.stream import Outlet, Stream
from sim_bus.errors import SimBusError
from sim_bus.tuning import STOP_S

_COMMAND = re.compile(rb"<\s*(\w+)\s*([^<>]*?)\s*>")


class FrameText:
    """Frames of one sample as the daemon writes them in raw mode.

    Args:
        kinds: the frames of a sample.
        clock: for the time stamps: when the sample was taken, by the wall clock at the start.
    """

    def __init__(self, kinds: Sequence[FrameKind], clock: PlayClock) -> None:
        self._heads = [(kind.digits, kind.size) for kind in kinds]
        self._clock = clock
        self._period_us = 1e6 / clock.sample_rate_hz

    def __call__(self, index: int, row: bytes) -> bytes:
        if not row:
            return b""  # the sample goes out with a later one
        time = self._stamp(index)
        out = []
        for digits, size in self._heads:
            data, row = row[:size], row[size:]
            out.append(_frame(digits, time, data))
        return b"".join(out)

    def _stamp(self, index: int) -> bytes:
        stamp = self._clock.start_wall_ns // 1000 + round(index * self._period_us)
        return b"%d.%06d" % divmod(stamp, 1_000_000)

    def strange(self, name: str, since: int, text: bytes) -> bytes:
        """Return the sample's text with what a fault sends besides it, or instead of it."""
        time = self._stamp(self._clock.played() - 1)
        if name == "dlc":
            return _WHOLE.sub(rb"\1 >", text)
        if name == "checksum":
            return _wrong_digit(text)
        if name == "bus-off":  # said once at the beginning, and again when the controller was restarted
            said = {0: _BUS_OFF, -1: _RESTARTED}
            return b"< error %03X %s >" % (said[since], time) if since in said else b""
        return self._beside(name, time) + text

    def _beside(self, name: str, time: bytes) -> bytes:
        """Return what comes before the sample."""
        digits, size = self._heads[0]
        if name == "error-frame":
            return b"< error %03X %s >" % (_BUS_ERROR, time)
        if name == "remote":
            return b"< rtr %s %s %d >" % (digits, time, min(size, 8))
        if name == "extended":
            return _frame(digits.rjust(8, b"0"), time, bytes(size))
        return b"".join(_frame(FOREIGN, time, bytes(8)) for _ in range(_CROWDS[name]))


FOREIGN = b"7E5"
_CROWDS = {"foreign": 1, "flood": 100}
_LAST_DIGIT = re.compile(rb"([0-9A-F]) >")
ADAPTERS_REPORT = ("error-warning", "error-passive", "overrun")
"""What a daemon does not pass on: it names no more than the class of an error."""
_WHOLE = re.compile(rb"(< frame [^<>]*?)[0-9A-F]{2} >")
_BUS_OFF, _BUS_ERROR, _RESTARTED = 0x40, 0x80, 0x100  # fixed by linux/can/error.h


def _wrong_digit(text: bytes) -> bytes:
    """Return a sample's text with the lowest bit of its last data byte turned."""
    return _LAST_DIGIT.sub(lambda match: b"%X >" % (int(match[1], 16) ^ 1), text, count=1)


def _frame(digits: bytes, time: bytes, data: bytes) -> bytes:
    return b"< frame %s %s %s >" % (digits, time, data.hex().upper().encode())


class Session(Outlet):
    """What one client is answered: first the handshake, then frames."""

    def __init__(self, buses: Mapping[str, Stream]) -> None:
        super().__init__()
        self._buses = buses
        self._bus: Stream | None = None
        self._input = b""
        self.sent_frames = 0

    def greet(self) -> None:
        """Say that the daemon is there."""
        self._answer(b"< hi >")

    def take_bytes(self, data: bytes) -> None:
        """Carry out what the client asks."""
        self._input = (self._input + data)[-4096:]
        while match := _COMMAND.search(self._input):
            self._input = self._input[match.end() :]
            self._carry_out(match[1], match[2])

    def _carry_out(self, command: bytes, argument: bytes) -> None:
        if command == b"open" and argument.decode("ascii", "replace") in self._buses:
            self._bus = self._buses[argument.decode()]
            self._answer(b"< ok >")
        elif command == b"rawmode" and self._bus is not None:
            self._answer(b"< ok >")
            self._bus.add(self)
        elif command == b"echo":
            self._answer(b"< echo >")
        elif command == b"send":
            self.sent_frames += 1
        else:
            self._answer(b"< error could not carry out %s >" % command)

    def _answer(self, text: bytes) -> None:
        self.put(text)
        self.flush()


class Client(Session):
    """One connection."""

    def __init__(self, connection: socket.socket, buses: Mapping[str, Stream]) -> None:
        super().__init__(buses)
        self.socket = connection
        connection.setblocking(False)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.greet()

    def receive(self) -> None:
        """Read and carry out what the client asks."""
        try:
            data = self.socket.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self.gone = self.gone or not data
        self.take_bytes(data)

    def _send(self, data: bytes) -> int:
        try:
            return self.socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self.gone = True
            return 0


@dataclass(frozen=True, slots=True)
class Endpoint:
    """Where a daemon listens."""

    host: str
    port: int


class SocketcandDevice(Device):
    """One daemon; one thread accepts, answers and sends.

    Args:
        clock: shared by all devices.
        endpoint: where it listens.
        buses: the stream of each bus by its name.
    """

    def __init__(self, clock: PlayClock, endpoint: Endpoint, buses: Mapping[str, Stream]) -> None:
        super().__init__(clock)
        self._endpoint = endpoint
        self._buses = buses
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._listener: socket.socket | None = None
        self._clients: list[Client] = []
        self._written_to_bus = 0

    def start(self) -> None:
        try:
            self._listener = self._listen()
        except OSError as error:
            words = f"port {self._endpoint.port} on {self._endpoint.host} cannot be opened: {error.strerror}"
            raise SimBusError(f'source "{next(iter(self._buses.values())).source}": {words}') from error
        self._thread = threading.Thread(target=self._run, name="socketcand device", daemon=True)
        self._thread.start()

    def _listen(self) -> socket.socket:
        listener = socket.socket(socket.AF_INET6 if ":" in self._endpoint.host else socket.AF_INET)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind((self._endpoint.host, self._endpoint.port))
            listener.listen()
        except OSError:
            listener.close()
            raise
        listener.setblocking(False)
        return listener

    def _run(self) -> None:
        with selectors.DefaultSelector() as selector:
            if self._listener is not None:
                selector.register(self._listener, selectors.EVENT_READ)
            while not self._stop.is_set():
                for key, _ in selector.select(min(stream.wait_s() for stream in self._buses.values())):
                    self._serve(key, selector)
                for stream in self._buses.values():
                    stream.step()
                self._plug(selector, plugged=not any(stream.disconnected for stream in self._buses.values()))
                self._drop_gone(selector)
            for client in self._clients:
                client.socket.close()

    def _plug(self, selector: selectors.BaseSelector, *, plugged: bool) -> None:
        """Let the daemon die, or come back."""
        if plugged and self._listener is None:
            self._listener = self._listen()
            selector.register(self._listener, selectors.EVENT_READ)
        elif not plugged and self._listener is not None:
            selector.unregister(self._listener)
            self._listener.close()
            self._listener = None
            for client in self._clients:
                client.gone = True

    def _serve(self, key: selectors.SelectorKey, selector: selectors.BaseSelector) -> None:
        if isinstance(key.data, Client):
            key.data.receive()
        elif self._listener is not None:
            client = Client(self._listener.accept()[0], self._buses)
            self._clients.append(client)
            selector.register(client.socket, selectors.EVENT_READ, client)

    def _drop_gone(self, selector: selectors.BaseSelector) -> None:
        for client in [client for client in self._clients if client.gone]:
            selector.unregister(client.socket)
            client.socket.close()
            self._clients.remove(client)
            self._written_to_bus += client.sent_frames

    def stop(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(STOP_S)
        if self._listener is not None:
            self._listener.close()

    def ledger(self) -> Mapping[str, dict[str, Any]]:
        written = self._written_to_bus + sum(client.sent_frames for client in self._clients)
        where = f"socketcand {self._endpoint.host}:{self._endpoint.port}"
        return {
            stream.source: {"bus": f"{where} {name}", "frames_from_clients": written, **stream.ledger()}
            for name, stream in self._buses.items()
        }
