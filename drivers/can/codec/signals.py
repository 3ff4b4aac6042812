"""CAN signals, read from many frames at once exactly as cantools reads them from one. Pure: no I/O."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.can.codec.frames import FRAME, FrameTable
from drivers.port import DriverConfigError, FloatArray, IntArray

if TYPE_CHECKING:
    from cantools.database.can import Signal

_DATA_AT = FRAME.fields["data"][1] if FRAME.fields else 0
_FLOATS = {16: np.float16, 32: np.float32, 64: np.float64}
_INTS = {16: np.uint16, 32: np.uint32, 64: np.uint64}


class SignalCodec:
    """One signal: where its bits lie and what they mean.

    Raises DriverConfigError for a signal of more than 64 bits.
    """

    def __init__(self, signal: "Signal") -> None:
        if not 0 < signal.length <= 64:
            raise DriverConfigError(f'signal "{signal.name}" has {signal.length} bits; up to 64 can be read')
        self.name = signal.name
        self.length = signal.length
        self._signed = signal.is_signed
        self._float = signal.is_float
        self._big = signal.byte_order == "big_endian"
        first = 8 * (signal.start // 8) + 7 - signal.start % 8 if self._big else signal.start
        self._first = first
        self._byte, bit = divmod(first, 8)
        bytes_used = (bit + self.length + 7) // 8
        self._ninth = bytes_used == 9
        # bits of the eight bytes read that lie below the signal
        self._below = (64 - bit - self.length) if self._big else bit
        self._scale, self._offset = signal.scale, signal.offset
        # adding an offset of 0 still turns -0.0 into 0.0
        self._may_add_nothing = not self._float and self._offset == 0 and self._scale > 0
        self._whole = self._number_type(bit)

    def _number_type(self, bit: int) -> np.dtype[np.generic] | None:
        """Return the type under which numpy reads the signal at once: whole bytes of a size that it knows."""
        if bit or self.length not in (8, 16, 32, 64):
            return None
        kind = "f" if self._float else "i" if self._signed else "u"
        return np.dtype(f"{'>' if self._big else '<'}{kind}{self.length // 8}")

    @property
    def resolution(self) -> float:
        """Smallest step of the value; 0.0 for floats."""
        return 0.0 if self._float else abs(float(self._scale))

    def byte_masks(self, size: int) -> NDArray[np.uint8]:
        """Return the bits that are the signal's in each of a frame's bytes, (size,)."""
        bits = np.zeros(8 * size, np.uint8)
        bits[self._first : self._first + self.length] = 1
        return np.packbits(bits, bitorder="big" if self._big else "little")

    def bits(self, table: FrameTable) -> NDArray[np.uint64]:
        """Return the signal's bits, (n,)."""
        word = self._word(table)
        if not self._ninth:
            word = word >> np.uint64(self._below)
        elif self._big:
            word = (word << np.uint64(-self._below)) | (self._next_byte(table) >> np.uint64(8 + self._below))
        else:
            word = (word >> np.uint64(self._below)) | (self._next_byte(table) << np.uint64(64 - self._below))
        return word & np.uint64((1 << self.length) - 1)

    def raw(self, table: FrameTable) -> NDArray[np.generic]:
        """Return the unscaled numbers, (n,): uint64, int64 or a float type."""
        if self._whole is not None and len(table):
            return self._at(table, self._whole)
        bits = self.bits(table)
        if self._float:
            return bits.astype(_INTS[self.length]).view(_FLOATS[self.length])
        if not self._signed:
            return bits
        spare = np.uint64(64 - self.length)
        return (bits << spare).view(np.int64) >> np.int64(64 - self.length)

    def counter(self, table: FrameTable) -> IntArray:
        """Return the bits as numbers that count, (n,)."""
        if self._whole is not None and not self._signed and len(table):
            return self._at(table, self._whole).astype(np.int64)
        return self.bits(table).astype(np.int64)

    def values(self, table: FrameTable) -> FloatArray:
        """Return raw * scale + offset, (n,), rounded where cantools rounds."""
        raw = self.raw(table)
        if self._scale == 1 and self._offset == 0:
            return raw.astype(np.float64)
        if self._float or not isinstance(self._scale, int):
            with np.errstate(
                invalid="ignore", over="ignore"
            ):  # any bits may be a float: NaN and inf are judged later
                values: FloatArray = np.multiply(raw, float(self._scale), dtype=np.float64)
                if self._may_add_nothing:
                    return values
                return np.add(values, float(self._offset), out=values)
        return self._exact(raw)

    def _exact(self, raw: NDArray[np.generic]) -> FloatArray:
        """Return integer * integer + offset without rounding the product, as Python's integers do."""
        whole = isinstance(self._offset, int) or float(self._offset).is_integer()
        if self.length + int(self._scale).bit_length() > 62 or (whole and abs(self._offset) > 2**62):
            product = raw.astype(object) * int(self._scale)
            return np.asarray(product + (int(self._offset) if whole else self._offset)).astype(np.float64)
        exact = raw.astype(np.int64) * int(self._scale)
        if whole:
            return (exact + int(self._offset)).astype(np.float64)
        return exact.astype(np.float64) + float(self._offset)

    def _word(self, table: FrameTable) -> NDArray[np.uint64]:
        if not len(table):
            return np.empty(0, np.uint64)
        return self._at(table, np.dtype(">u8" if self._big else "<u8")).astype(np.uint64)

    def _at(self, table: FrameTable, kind: np.dtype[np.generic]) -> NDArray[np.generic]:
        """Return the numbers of this type that begin at the signal's first byte, (n,)."""
        return np.ndarray(len(table), kind, table.data, _DATA_AT + self._byte, (FRAME.itemsize,))

    def _next_byte(self, table: FrameTable) -> NDArray[np.uint64]:
        column: NDArray[np.uint8] = table["data"][:, self._byte + 8]
        return column.astype(np.uint64)
