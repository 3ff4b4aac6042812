"""Frames as the kernel lays them out, sent to one of its CAN interfaces or to python-can's virtual bus."""

import errno
import socket
import struct
import time
from abc import abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import can
from can.interfaces.virtual import channels

from sim_bus.devices.can.packing import FrameKind
from sim_bus.devices.stream import Outlet
from sim_bus.errors import SimBusError
from sim_bus.tuning import REOPEN_S

_EXTENDED = 0x80000000  # fixed by linux/can.h
_CLASSIC, _FD = 16, 72  # fixed by linux/can.h
_CAN_HEAD = struct.Struct("=IB3x")
_LISTENERS = Path("/proc/net/can")


class KernelFrames:
    """Makes the kernel's can_frame (16 bytes) or canfd_frame (72 bytes) of a sample's rows."""

    def __init__(self, kinds: Sequence[FrameKind]) -> None:
        self._kinds = tuple(kinds)
        self.size = _FD if any(kind.fd for kind in kinds) else _CLASSIC

    def __call__(self, _index: int, row: bytes) -> bytes:
        if not row:
            return b""  # the sample goes out with a later one
        frames = []
        for kind in self._kinds:
            data, row = row[: kind.size], row[kind.size :]
            number = kind.identifier | (_EXTENDED if kind.extended else 0)
            frames.append(_CAN_HEAD.pack(number, kind.size) + data.ljust(self.size - 8, b"\0"))
        return b"".join(frames)


class FrameOutlet(Outlet):
    """One end of a bus that takes the kernel's can_frame or canfd_frame.

    Args:
        channel: the interface, or the bus by its name within the process.
        size: bytes of a frame: 16, or 72 for FD.
    """

    limit = 1 << 18
    interface: ClassVar[str]

    def __init__(self, channel: str, size: int) -> None:
        super().__init__()
        self._channel = channel
        self._size = size
        self.bus = f"{self.interface} {channel}"
        self.not_sent = 0

    @abstractmethod
    def open(self) -> None:
        """Join the bus. Raises SimBusError where there is none."""

    @abstractmethod
    def has_listener(self) -> bool:
        """Tell whether anybody listens."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus; harmless when left already."""


class KernelOutlet(FrameOutlet):
    """A raw socket on one interface. While the interface is down or gone, frames are lost, as on a wire."""

    interface = "socketcan"
    _retry_at = 0.0
    _socket: socket.socket | None = None

    def open(self) -> None:
        """Open the interface; SimBusError when there is none."""
        try:
            self._socket = self._opened()
        except (AttributeError, OSError) as error:
            words = "this kernel has no CAN" if _no_can(error) else f"cannot be opened: {error}"
            raise SimBusError(
                f"{self._channel}: {words}; a socketcand on 127.0.0.1 can be played anywhere"
            ) from error

    def _opened(self) -> socket.socket:
        opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        try:
            # an empty filter: this end only sends, and is no listener in the kernel's list
            opened.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
            opened.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, int(self._size == _FD))
            opened.setblocking(False)
            opened.bind((self._channel,))
        except OSError:
            opened.close()
            raise
        return opened

    def _send(self, data: bytes) -> int:
        whole = len(data) // self._size * self._size
        if self._socket is None and not self._reopened():
            return self._lose(data[:whole])
        return self._send_frame(data[: self._size])

    def _send_frame(self, frame: bytes) -> int:
        try:
            return self._socket.send(frame) if self._socket else 0
        except BlockingIOError:
            return 0
        except OSError as error:
            if error.errno == errno.ENOBUFS:
                return 0
            if error.errno != errno.ENETDOWN:
                self.close()
            return self._lose(frame)

    def _lose(self, data: bytes) -> int:
        self.not_sent += len(data) // self._size
        return len(data)

    def _reopened(self) -> bool:
        if time.monotonic() < self._retry_at:
            return False
        self._retry_at = time.monotonic() + REOPEN_S
        try:
            self._socket = self._opened()
        except OSError:
            return False
        return True

    def has_listener(self) -> bool:
        """Tell whether any socket in this machine listens to the interface."""
        for table in _LISTENERS.glob("rcvlist_*"):
            for line in table.read_text(encoding="ascii").splitlines():
                words = line.split()
                if words[:1] == [self._channel] and len(words) > 4:
                    return True
        return False

    def close(self) -> None:
        """Let go of the interface."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


def _no_can(error: Exception) -> bool:
    return isinstance(error, AttributeError) or getattr(error, "errno", None) == errno.EAFNOSUPPORT


class VirtualOutlet(FrameOutlet):
    """One end of python-can's virtual bus, which reaches the readers of this process and nobody else."""

    interface = "virtual"
    _bus: can.BusABC | None = None

    def open(self) -> None:
        """Join the bus; it is there as soon as somebody does."""
        self._bus = can.Bus(self._channel, "virtual")

    def has_listener(self) -> bool:
        """Tell whether anybody of this process has joined the bus beside this end."""
        return len(channels[self._channel]) > 1

    def close(self) -> None:
        """Leave the bus; harmless when left already."""
        if self._bus is not None:
            self._bus.shutdown()
        self._bus = None

    def _send(self, data: bytes) -> int:
        frame = data[: self._size]
        number, size = _CAN_HEAD.unpack_from(frame)
        is_extended = bool(number & _EXTENDED)
        message = can.Message(
            arbitration_id=number & ~_EXTENDED, is_extended_id=is_extended, is_fd=self._size > 16,
            data=frame[_CAN_HEAD.size : _CAN_HEAD.size + size],
        )  # fmt: skip
        if self._bus is not None:
            self._bus.send(message)
        return self._size
