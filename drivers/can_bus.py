"""Where CAN frames come from: the kernel, a socketcand daemon, or any other bus that python-can speaks to.

Each bus is read by one thread in a loop of its own. Nothing is ever sent but socketcand's handshake.
"""

import os
import select
import socket
import struct
from abc import ABC, abstractmethod
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from drivers import clock
from drivers.can_frames import (
    ERROR,
    EXTENDED,
    FD_FLAG,
    REMOTE,
    DaemonText,
    Frames,
    frames_of,
    no_frames,
    pack_frame,
)
from drivers.pipe import tcp_pipe
from drivers.port import Counts, DriverConfigError, DriverIOError, DriverSettings

if TYPE_CHECKING:
    import can

_MOST = 4096
_RECEIVE_BUFFER = 4 << 20
_CAN_RAW_ERR_FILTER = 2
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_TIMESPEC = struct.Struct("@qq")
_CONNECT_S = 2.0

Filters = tuple[tuple[int, int], ...]
"""(number, mask) each: frames whose identifier, flag bits included, equals number within mask are wanted."""


class BusKeys(DriverSettings):
    """Which bus to listen to."""

    interface: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    channel: str = Field(min_length=1, max_length=64)
    host: str = "127.0.0.1"
    port: int = Field(default=29536, gt=0, lt=65536)
    bitrate: int | None = Field(default=None, gt=0)
    fd: bool = False


class CanBus(ABC):
    """An open bus. Frames that the bus says it lost are added to counts.dropped."""

    @abstractmethod
    def frames(self, deadline: float) -> Frames:
        """Return what has arrived, waiting until `deadline` (clock.monotonic); DriverIOError when the bus is gone."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the bus; harmless when let go already."""


class KernelBus(CanBus):
    """SocketCAN: a raw socket with the kernel's filters, time stamps and count of lost frames."""

    def __init__(self, keys: BusKeys, filters: Filters, counts: Counts) -> None:
        self._name = keys.channel
        self._counts = counts
        self._lost = 0
        self._failure: DriverIOError | None = None
        try:
            self._socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except (AttributeError, OSError) as error:
            raise DriverIOError(f"{self._name}: this kernel has no CAN; try a socketcand elsewhere") from error
        try:
            self._set_up(keys, filters)
        except OSError as error:
            self._socket.close()
            raise DriverIOError(f"{self._name}: {error.strerror or error}") from error

    def _set_up(self, keys: BusKeys, filters: Filters) -> None:
        packed = b"".join(struct.pack("=II", number, mask) for number, mask in filters)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed)
        self._socket.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, struct.pack("=I", ERROR - 1))
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(keys.fd))
        self._widen_buffer()
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self._socket.setblocking(False)
        self._socket.bind((keys.channel,))

    def _widen_buffer(self) -> None:
        """Ask for room for seconds of frames; without the right to it the kernel's limit (rmem_max) stands."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        with suppress(PermissionError):
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)

    def frames(self, deadline: float) -> Frames:
        if self._failure is not None:
            raise self._failure
        select.select([self._socket], [], [], max(0.0, deadline - clock.monotonic()))
        rows: list[bytes] = []
        times: list[int] = []
        while len(rows) < _MOST:
            try:
                data, extra, _, _ = self._socket.recvmsg(72, 128)
            except BlockingIOError:
                break
            except OSError as error:
                # the kernel tells only once that an interface went down: the frames before it go out first
                self._failure = DriverIOError(f"{self._name}: {error.strerror or error}")
                if rows:
                    break
                raise self._failure from error
            rows.append(data.ljust(80, b"\0"))
            times.append(self._ancillary(extra))
        return frames_of(rows, np.array(times, np.int64)) if rows else no_frames()

    def _ancillary(self, extra: list[tuple[int, int, bytes]]) -> int:
        t_ns = 0
        for _, kind, data in extra:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack_from(data)
                t_ns = seconds * 10**9 + nanoseconds
            elif kind == _SO_RXQ_OVFL:
                lost = int.from_bytes(data[:4], "little")
                self._counts.dropped["kernel queue"] += (lost - self._lost) % (1 << 32)
                self._lost = lost
        return t_ns

    def close(self) -> None:
        self._socket.close()


class DaemonBus(CanBus):
    """socketcand over TCP, in raw mode."""

    def __init__(self, keys: BusKeys, counts: Counts) -> None:
        self._counts = counts
        self._pipe = tcp_pipe(keys.host, keys.port, _CONNECT_S)
        self._text = DaemonText()
        self._channel = keys.channel
        try:
            self._expect(b"< hi >", b"")
            self._expect(b"< ok >", b"< open %s >" % keys.channel.encode())
            self._expect(b"< ok >", b"< rawmode >")
        except DriverIOError:
            self._pipe.close()
            raise

    def _expect(self, answer: bytes, command: bytes) -> None:
        if command:
            self._pipe.send("socketcand", command)
        deadline = clock.monotonic() + _CONNECT_S
        got = b""
        while answer not in got:
            more = self._pipe.recv(deadline)
            got += more
            # frames may come right behind the answer, more of them than an answer would ever have bytes
            if answer not in got and (not more or b"< error" in got or len(got) > 4096):
                raise DriverIOError(
                    f"{self._pipe.name}: socketcand answers {got[:80]!r} to {command.decode() or 'the connection'}; "
                    f"does it serve {self._channel}?"
                )
        self._keep_frames(got.partition(answer)[2])

    def _keep_frames(self, rest: bytes) -> None:
        """Keep frames that came right behind an answer."""
        self._early = rest

    def frames(self, deadline: float) -> Frames:
        early, self._early = self._early, b""
        data = early + self._pipe.recv(clock.monotonic() if early else deadline)
        bad = self._text.bad
        frames = self._text.feed(data) if data else no_frames()
        if self._text.bad > bad:
            self._counts.received += self._text.bad - bad
            self._counts.rejected["text"] += self._text.bad - bad
        return frames

    def close(self) -> None:
        self._pipe.close()


class PythonCanBus(CanBus):
    """Any other interface of python-can.

    The library's filters are not used: with them `recv` says that nothing came when a foreign frame did.
    """

    def __init__(self, keys: BusKeys) -> None:
        import can

        self._name = f"{keys.interface} {keys.channel}"
        self._errors = (can.CanError, OSError, ValueError)
        extra: dict[str, Any] = {"fd": keys.fd, **({"bitrate": keys.bitrate} if keys.bitrate else {})}
        try:
            self._bus: can.BusABC = can.Bus(keys.channel, keys.interface, **extra)
        except can.CanInterfaceNotImplementedError as error:
            raise DriverConfigError(f'python-can has no interface "{keys.interface}" here: {error}') from error
        except self._errors as error:
            raise DriverIOError(f"{self._name}: {error}") from error

    def frames(self, deadline: float) -> Frames:
        rows: list[bytes] = []
        times: list[float] = []
        wait = max(0.0, deadline - clock.monotonic())
        try:
            while len(rows) < _MOST and (message := self._bus.recv(0.0 if rows else wait)) is not None:
                rows.append(message_row(message))
                times.append(message.timestamp)
        except self._errors as error:
            raise DriverIOError(f"{self._name}: {error}") from error
        return frames_of(rows, np.rint(np.array(times) * 1e9).astype(np.int64)) if rows else no_frames()

    def close(self) -> None:
        try:
            self._bus.shutdown()
        except self._errors:
            os.sched_yield()  # a bus that is gone cannot be shut down: nothing is left to release


def message_row(message: "can.Message") -> bytes:
    """Return a message of python-can as a row of a frame table."""
    number = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
    number |= (REMOTE if message.is_remote_frame else 0) | (ERROR if message.is_error_frame else 0)
    data = b"" if message.is_remote_frame else bytes(message.data[:64])
    return pack_frame(number & 0xFFFFFFFF, data, FD_FLAG if message.is_fd else 0, min(message.dlc, 64))


def open_bus(keys: BusKeys, filters: Filters, counts: Counts) -> CanBus:
    """Open the bus that the keys name."""
    if keys.interface == "socketcan":
        return KernelBus(keys, filters, counts)
    if keys.interface == "socketcand":
        return DaemonBus(keys, counts)
    return PythonCanBus(keys)
