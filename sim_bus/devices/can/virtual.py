"""Frames sent to python-can's virtual bus, which reaches the readers of this process and nobody else."""

import struct

import can
from can.interfaces.virtual import channels

from sim_bus.devices.stream import Outlet

_EXTENDED = 0x80000000
_HEAD = struct.Struct("=IB3x")


class VirtualOutlet(Outlet):
    """One end of a virtual bus, which takes the kernel's can_frame or canfd_frame.

    Args:
        channel: the bus, by its name within the process.
        size: bytes of a frame: 16, or 72 for FD.
    """

    limit = 1 << 18

    def __init__(self, channel: str, size: int) -> None:
        super().__init__()
        self._channel = channel
        self._size = size
        self._bus: can.BusABC | None = None
        self.bus = f"virtual {channel}"
        self.not_sent = 0

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
        number, size = _HEAD.unpack_from(frame)
        is_extended = bool(number & _EXTENDED)
        message = can.Message(
            arbitration_id=number & ~_EXTENDED, is_extended_id=is_extended, is_fd=self._size > 16,
            data=frame[_HEAD.size : _HEAD.size + size],
        )  # fmt: skip
        if self._bus is not None:
            self._bus.send(message)
        return self._size
