"""Samples as CAN frames by what a DBC file says: every signal's bits set in all frames at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.can.codec.checksums import FrameCheck
from drivers.can.codec.database import next_name
from drivers.can.codec.frames import FRAME
from drivers.can.codec.layout import ChecksumKeys, FrameKeys
from drivers.can.codec.signals import SignalCodec
from sim_bus.devices.wire import NumberArray, Raw, WireNumber
from sim_bus.errors import SimUsageError
from sim_bus.rig.rigfile import Source
from sim_bus.tuning import CHUNK

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

FD_LENGTHS = (8, 12, 16, 20, 24, 32, 48, 64)  # fixed by ISO 11898-1
_FLOATS = {32: (np.float32, np.uint32), 64: (np.float64, np.uint64)}


@dataclass(frozen=True, slots=True)
class FrameKind:
    """One message: identifier, whether it is extended and FD, and its bytes on the wire."""

    name: str
    identifier: int
    extended: bool
    fd: bool
    size: int

    @property
    def digits(self) -> bytes:
        """The identifier as text."""
        return f"{self.identifier:08X}".encode() if self.extended else f"{self.identifier:03X}".encode()


def load_database(path: Path, key: str) -> "Database":
    """Return the DBC file's content; SimUsageError when it cannot be read."""
    import cantools
    from cantools.database.can import Database
    from cantools.database.errors import Error

    try:
        database = cantools.database.load_file(str(path), prune_choices=False)
    except (OSError, Error, ValueError, LookupError, AttributeError) as error:
        raise SimUsageError(f"{key}: {path}: {error}") from error
    if not isinstance(database, Database):
        raise SimUsageError(f"{key}: {path}: no messages of a bus are in it")
    return database


class Packing:
    """The messages that carry one source's fields.

    Args:
        database: the DBC file's content.
        source: the source, its map naming fields as "Message.Signal".
        fd: whether the bus carries FD frames.
        keys: how samples lie in frames beyond what the DBC file says.
    """

    def __init__(
        self, database: "Database", source: Source, *, fd: bool, keys: FrameKeys | None = None
    ) -> None:
        self._keys = keys or FrameKeys(dbc=Path())
        fields = [*source.map.values(), *([source.counter] if source.counter else [])]
        names = dict.fromkeys(field.partition(".")[0] for field in fields)
        self._messages = [_message(database, name, source.name) for name in names]
        self.kinds = tuple(_kind(message, fd=fd) for message in self._messages)
        self._places = {
            f"{message.name}.{signal.name}": _places(signal)
            for message in self._messages
            for signal in message.signals
        }
        self._check(fields, source.name)
        self._later = self._later_signals(fields, source)

    def _later_signals(self, fields: Sequence[str], source: Source) -> dict[str, tuple[str, int]]:
        """Return, of each signal of a frame's later samples, the first sample's signal and how much later."""
        count = self._keys.samples_per_frame
        if CHUNK % count or len(self._messages) > 1 < count or self._keys.counter_counts == "frames":
            words = (
                f"samples_per_frame = {count}: only 2, 4, 8 ... of one message "
                "that counts samples can be simulated"
            )
            raise SimUsageError(f'source "{source.name}": {words}')
        return {
            next_name(field, place): (field, place) for place in range(1, count) for field in fields
            if field != source.counter
        }  # fmt: skip

    def _check(self, fields: Sequence[str], source: str) -> None:
        signals = {f"{m.name}.{s.name}": s for m in self._messages for s in m.signals}
        lost = [field for field in fields if field not in signals]
        if lost:
            raise SimUsageError(f'source "{source}": no signal is called {", ".join(lost)} in its DBC file')
        switched = [field for field in fields if signals[field].multiplexer_ids]
        if switched:
            raise SimUsageError(
                f'source "{source}": {", ".join(switched)}: multiplexed signals cannot be simulated'
            )

    @property
    def numbers(self) -> list[WireNumber]:
        """Every signal as a field on the wire."""
        return [_number(message, signal) for message in self._messages for signal in message.signals]

    @property
    def size(self) -> int:
        """Bytes of all frames of one sample."""
        return sum(kind.size for kind in self.kinds)

    def pack(self, raw: Raw) -> list[bytes]:
        """Return the frames' data of each sample, one after another."""
        count = self._keys.samples_per_frame
        firsts = {name: numbers[::count] for name, numbers in raw.items()}
        firsts |= {name: raw[field][place::count] for name, (field, place) in self._later.items()}
        frames = len(next(iter(firsts.values())))
        parts = [
            self._packed(message, kind, firsts, frames)
            for message, kind in zip(self._messages, self.kinds, strict=True)
        ]
        data = np.hstack(parts).tobytes()
        size = self.size
        # a frame of several samples goes out when the last one is due
        rows = [[b""] * (count - 1) + [data[start : start + size]] for start in range(0, len(data), size)]
        return [row for frame in rows for row in frame]

    def _packed(self, message: "Message", kind: FrameKind, raw: Raw, samples: int) -> NDArray[np.uint8]:
        bits = np.zeros((samples, 8 * kind.size), dtype=np.uint8)
        for signal in message.signals:
            if not signal.multiplexer_ids:
                field = f"{message.name}.{signal.name}"
                bits[:, self._places[field]] = _bits(raw[field], signal)
        if self._keys.checksum is not None:
            self._add_checksum(self._keys.checksum, message, bits)
        return np.packbits(bits, axis=1)

    def _add_checksum(self, keys: ChecksumKeys, message: "Message", bits: NDArray[np.uint8]) -> None:
        """Set the checksum's bits in frames (n, bits)."""
        signal = message.get_signal_by_name(keys.signal)
        table = np.zeros(len(bits), FRAME)
        table["data"][:, : bits.shape[1] // 8] = np.packbits(bits, axis=1)
        check = FrameCheck(keys, SignalCodec(signal), message.length).calculated(table)
        bits[:, self._places[f"{message.name}.{signal.name}"]] = _bits(check.astype(np.int64), signal)


def _message(database: "Database", name: str, source: str) -> "Message":
    for message in database.messages:
        if message.name == name:
            return message
    known = ", ".join(message.name for message in database.messages[:20])
    raise SimUsageError(f'source "{source}": no message is called "{name}"; messages are {known}')


def _kind(message: "Message", *, fd: bool) -> FrameKind:
    size = message.length
    if fd and size > 8:
        size = min(length for length in FD_LENGTHS if length >= size)
    if size > (64 if fd else 8):
        raise SimUsageError(
            f'message "{message.name}" has {size} bytes; classic frames carry 8, set fd = true for 64'
        )
    return FrameKind(message.name, message.frame_id, message.is_extended_frame, fd, size)


def _number(message: "Message", signal: "Signal") -> WireNumber:
    name = f"{message.name}.{signal.name}"
    if signal.is_float:
        return WireNumber(name, None, None, float(signal.scale), float(signal.offset))
    top = 1 << signal.length
    low, high = (-top // 2, top // 2 - 1) if signal.is_signed else (0, top - 1)
    return WireNumber(name, low, high, float(signal.scale), float(signal.offset))


def _places(signal: "Signal") -> list[int]:
    """Return where each bit of a signal lies in the frame, most significant first, counted along the wire.

    A DBC file numbers bits from the least significant of byte 0. Little-endian signals are given by their
    lowest bit and grow upwards; big-endian ones by their highest, going down to bit 0 of a byte and on at bit
    7 of the next.
    """
    if signal.byte_order == "little_endian":
        numbers = [signal.start + k for k in reversed(range(signal.length))]
    else:
        numbers = [signal.start]
        while len(numbers) < signal.length:
            numbers.append(numbers[-1] - 1 if numbers[-1] % 8 else numbers[-1] + 15)
    return [8 * (number // 8) + 7 - number % 8 for number in numbers]


def _bits(raw: NumberArray, signal: "Signal") -> NDArray[np.uint8]:
    """Return the bits of raw numbers (n, length), most significant first."""
    if signal.is_float:
        number, word = _FLOATS[signal.length]
        words = raw.astype(number).view(word).astype(np.uint64)
    else:
        words = raw.astype(np.int64).view(np.uint64)
    shifts = np.arange(signal.length - 1, -1, -1, dtype=np.uint64)
    return ((words[:, None] >> shifts) & np.uint64(1)).astype(np.uint8)
