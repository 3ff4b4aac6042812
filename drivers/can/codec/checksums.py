"""Checksums inside frames, of many frames at once. Pure: no I/O."""

import numpy as np
from numpy.typing import NDArray

from drivers import crc
from drivers.can.codec.frames import FrameTable
from drivers.can.codec.layout import SUM, XOR, ChecksumKeys
from drivers.can.codec.signals import SignalCodec
from drivers.fields import ByteArray
from drivers.port import BoolArray, DriverConfigError


class FrameCheck:
    """The check of one message's frames.

    Args:
        keys: how it is calculated.
        signal: where it stands.
        length: bytes of the message.

    Raises DriverConfigError for a signal that the method does not fit.
    """

    def __init__(self, keys: ChecksumKeys, signal: SignalCodec, length: int) -> None:
        self._signal = signal
        self._method = keys.method
        self._width = signal.length
        self._before = np.frombuffer(bytes.fromhex(keys.data_id), np.uint8)
        masks = signal.byte_masks(length)
        self._kept = np.flatnonzero(masks != 0xFF) if keys.over == "others" else np.arange(length)
        self._zeroed = ~masks[self._kept]
        if keys.over == "others" and not np.isin(masks, (0, 0xFF)).all():
            raise DriverConfigError(
                f'the checksum "{signal.name}" fills no whole bytes; over = "zeroed" takes its bits as 0'
            )
        self._check_width()

    def _check_width(self) -> None:
        wanted = {XOR: 8, SUM: self._width}.get(self._method) or crc.by_name(self._method).width
        if self._width != wanted:
            name = self._signal.name
            raise DriverConfigError(
                f'the checksum "{name}" has {self._width} bits; {self._method} makes {wanted}'
            )

    def holds(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether its checksum is right."""
        right: BoolArray = self.calculated(table) == self._signal.bits(table)
        return right

    def calculated(self, table: FrameTable) -> NDArray[np.uint64]:
        """Return what the checksum of each frame must be, (n,)."""
        data: ByteArray = table["data"][:, self._kept] & self._zeroed
        before = np.broadcast_to(self._before, (len(data), len(self._before)))
        data = np.hstack([before, data])
        if self._method == XOR:
            return np.asarray(np.bitwise_xor.reduce(data, axis=1), np.uint64)
        if self._method == SUM:
            return np.asarray(data.sum(axis=1, dtype=np.uint64) & np.uint64((1 << self._width) - 1))
        return crc.by_name(self._method).of(data).astype(np.uint64)
