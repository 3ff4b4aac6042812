"""Frames sent to a CAN interface of the kernel, as the kernel lays them out."""

import errno
import socket
import struct
import time
from collections.abc import Sequence
from pathlib import Path

from sim_bus.devices.can.packing import FrameKind
from sim_bus.devices.stream import Outlet
from sim_bus.errors import SimBusError

_EXTENDED = 0x80000000
_CLASSIC, _FD = 16, 72
_LISTENERS = Path("/proc/net/can")
_REOPEN_S = 0.1


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
            frames.append(struct.pack("=IB3x", number, kind.size) + data.ljust(self.size - 8, b"\0"))
        return b"".join(frames)


class KernelOutlet(Outlet):
    """A raw socket on one interface. While the interface is down or gone, frames are lost, as on a wire.

    Args:
        channel: the interface.
        size: bytes of a frame: 16, or 72 for FD.
    """

    limit = 1 << 18

    def __init__(self, channel: str, size: int) -> None:
        super().__init__()
        self._channel = channel
        self._size = size
        self._retry_at = 0.0
        self.bus = f"socketcan {channel}"
        self.not_sent = 0
        self._socket: socket.socket | None = None

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
        self._retry_at = time.monotonic() + _REOPEN_S
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
