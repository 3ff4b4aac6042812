"""Byte pipes to a device, TCP or a serial line: deadlines on the monotonic clock, failures as DriverIOError.

The libraries' own waits use the wall clock (a step of it stretches them) and poll a serial line with sleeps;
these select on the descriptor. What may be sent is decided by `drivers.write_gate`.
"""

import os
import select
import socket
from abc import ABC, abstractmethod

from drivers import clock, write_gate
from drivers.port import DriverIOError
from drivers.serial_port import SerialKeys, close_port, open_port
from drivers.tuning import READ_BYTES


class Pipe(ABC):
    """An open connection; `name` is for messages."""

    name: str

    @abstractmethod
    def fileno(self) -> int:
        """Return the descriptor."""

    @abstractmethod
    def send(self, protocol: str, data: bytes) -> None:
        """Write bytes that a listener may write; DriverIOError when the line is gone."""

    @abstractmethod
    def _read(self) -> bytes:
        """Read what is there; called only when there is something."""

    @abstractmethod
    def close(self) -> None:
        """Release the descriptor; harmless when released already."""

    def recv(self, deadline: float) -> bytes:
        """Return what has arrived, waiting until `deadline` (clock.monotonic); b"" when nothing came."""
        ready, _, _ = select.select([self.fileno()], [], [], max(0.0, deadline - clock.monotonic()))
        return self._read() if ready else b""

    def drain(self, seconds: float) -> int:
        """Throw away what arrives within `seconds`; return how many bytes that were."""
        deadline = clock.monotonic() + seconds
        thrown = 0
        while data := self.recv(deadline):
            thrown += len(data)
        return thrown


class PlayedMachine(clock.PlayedTime):
    """A machine whose time and lines somebody plays."""

    @abstractmethod
    def tcp(self, host: str, port: int) -> Pipe:
        """Return a connection; DriverIOError when there is none to be had."""

    @abstractmethod
    def serial(self, device: str) -> Pipe:
        """Return an open serial line; DriverIOError when it is not there."""


class TcpPipe(Pipe):
    """A TCP connection; raises DriverIOError when it cannot be made within timeout_s."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self.name = f"{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout_s)
        except OSError as error:
            raise DriverIOError(f"{self.name}: {error.strerror or error}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        return self._socket.fileno()

    def send(self, protocol: str, data: bytes) -> None:
        try:
            write_gate.send(protocol, self._socket, data)
        except OSError as error:
            raise DriverIOError(f"{self.name}: {error.strerror or error}") from error

    def _read(self) -> bytes:
        try:
            data = self._socket.recv(READ_BYTES)
        except OSError as error:
            raise DriverIOError(f"{self.name}: {error.strerror or error}") from error
        if not data:
            raise DriverIOError(f"{self.name}: the device closed the connection")
        return data

    def close(self) -> None:
        self._socket.close()


class SerialPipe(Pipe):
    """A serial line, read in large blocks from its descriptor; read-only, the kernel refuses every write."""

    def __init__(self, keys: SerialKeys, device: str, *, read_only: bool = False) -> None:
        self.name = device
        self._descriptor = open_port(keys, device, read_only=read_only)

    def fileno(self) -> int:
        return self._descriptor

    def send(self, protocol: str, data: bytes) -> None:
        try:
            _write_all(self.fileno(), write_gate.check(protocol, data))
        except OSError as error:
            raise DriverIOError(f"{self.name}: {error.strerror or error}") from error

    def _read(self) -> bytes:
        try:
            data = os.read(self.fileno(), READ_BYTES)
        except OSError as error:
            raise DriverIOError(f"{self.name}: {error.strerror or error}") from error
        if not data:
            raise DriverIOError(f"{self.name}: the line was unplugged")
        return data

    def close(self) -> None:
        if self._descriptor >= 0:
            close_port(self._descriptor)
        self._descriptor = -1


def _write_all(descriptor: int, data: bytes) -> None:
    while data:
        data = data[os.write(descriptor, data) :]


def tcp_pipe(host: str, port: int, timeout_s: float) -> Pipe:
    """Return a TCP connection of this machine, or of the one that is played to this thread."""
    machine = clock.played()
    return machine.tcp(host, port) if isinstance(machine, PlayedMachine) else TcpPipe(host, port, timeout_s)


def serial_pipe(keys: SerialKeys, device: str, *, read_only: bool = False) -> Pipe:
    """Return a serial line of this machine, or of the one that is played to this thread."""
    machine = clock.played()
    if isinstance(machine, PlayedMachine):
        return machine.serial(device)
    return SerialPipe(keys, device, read_only=read_only)
