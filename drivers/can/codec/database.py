"""What of a DBC file a source needs: its messages, their signals, and how frames are recognised. No bus."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.can.codec.checksums import FrameCheck
from drivers.can.codec.frames import ERROR, EXTENDED, EXTENDED_MASK, FD_LENGTHS, REMOTE, FrameTable
from drivers.can.codec.layout import FrameKeys
from drivers.can.codec.python_can import import_lean
from drivers.can.codec.samples import FrameCounter, Page, Selected, pages_of, shows
from drivers.can.codec.signals import SignalCodec
from drivers.port import BoolArray, DriverConfigError, FloatArray, IntArray

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_J1939_BROADCAST = 0xF0  # fixed by SAE J1939-21: from this PDU format on a message is to all


@dataclass(frozen=True, slots=True)
class MessageCodec:
    """One message: how its frames are recognised and what is read from them.

    Attributes:
        name: the message's name.
        number, mask: a frame belongs to it when its identifier, flag bits included, equals number within
            mask.
        lengths: data lengths that are right.
        samples: the signals asked for, of each sample that a frame carries.
        pages: the columns that come together: one page, or one for each choice of the multiplexers.
        counter: what numbers the samples, or None.
        switches: the multiplexers that lead to asked signals, and every number that they can show.
        check: the checksum in its frames, or None.
    """

    name: str
    number: int
    mask: int
    lengths: tuple[int, ...]
    samples: tuple[tuple[Selected, ...], ...]
    pages: tuple[Page, ...]
    counter: FrameCounter | None
    switches: tuple[tuple[SignalCodec, tuple[int, ...]], ...] = ()
    check: FrameCheck | None = None

    @property
    def selected(self) -> tuple[Selected, ...]:
        """The signals of a frame's first sample."""
        return self.samples[0]

    def mine(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether it belongs to the message."""
        matching: BoolArray = (table["id"] & np.uint32(self.mask | ERROR)) == np.uint32(self.number)
        return matching

    def all_sound(self, table: FrameTable) -> bool:
        """Tell whether every frame is a whole one of this message: the usual case, told the shortest way."""
        flags = np.uint32(self.mask | ERROR | REMOTE)
        whole = ((table["id"] & flags) == np.uint32(self.number)).all() and self.right_length(table).all()
        return bool(whole and self.right_sum(table).all() and self.right_counter(table).all())

    def right_length(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether it has as many bytes as the message."""
        lengths = table["length"]
        right: BoolArray = lengths == self.lengths[0]
        for other in self.lengths[1:]:
            right |= lengths == other
        return right

    def right_sum(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether its checksum is right; all of them where there is none."""
        return np.ones(len(table), np.bool_) if self.check is None else self.check.holds(table)

    def right_counter(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether its counter shows a number that it can have."""
        return np.ones(len(table), np.bool_) if self.counter is None else self.counter.possible(table)

    def knows(self, table: FrameTable) -> BoolArray:
        """Tell of each frame whether every multiplexer in it shows a number that the database knows."""
        known = np.ones(len(table), np.bool_)
        for switch, numbers in self.switches:
            known &= shows(table, switch, numbers)
        return known

    def values(self, table: FrameTable, columns: int) -> FloatArray:
        """Return the asked signals in their columns, a row a sample, NaN elsewhere."""
        shape = (len(table), len(self.samples), columns)
        out = np.empty(shape) if len(self.selected) == columns else np.full(shape, np.nan)
        for place, signals in enumerate(self.samples):
            for signal in signals:
                out[:, place, signal.column] = signal.values(table)
        return out.reshape(-1, columns)

    def numbers(self, table: FrameTable) -> IntArray | None:
        """Return the counter of each sample, or None."""
        return None if self.counter is None else self.counter.numbers(table)


def load(path: Path) -> "Database":
    """Return the parsed DBC; DriverConfigError when it cannot be read."""
    import_lean()
    import cantools
    from cantools.database.can import Database
    from cantools.database.errors import Error

    try:
        database = cantools.database.load_file(str(path), prune_choices=False)
    except OSError as error:
        raise DriverConfigError(f"{path}: {error.strerror or error}") from error
    except (Error, ValueError, LookupError, AttributeError) as error:
        raise DriverConfigError(f"{path}: is no CAN database that can be read: {error}") from error
    if not isinstance(database, Database):
        raise DriverConfigError(f"{path}: describes diagnostics, not the messages of a bus")
    return database


def message_codecs(
    database: "Database", fields: tuple[str, ...], counter: str | None, keys: FrameKeys | None = None
) -> tuple[MessageCodec, ...]:
    """Return the messages that carry the fields ("Message.Signal"); DriverConfigError names what is missing.

    Several messages make one sample when each has a counter signal of the name that `counter` gives.
    """
    keys = keys or FrameKeys(dbc=Path())
    wanted: dict[str, list[tuple[int, str]]] = {}
    for column, field in enumerate(fields):
        message, signal = _split(field)
        wanted.setdefault(message, []).append((column, signal))
    if counter is None and len(wanted) > 1:
        raise DriverConfigError(
            f"fields come from {len(wanted)} messages; a counter in each is needed to join them"
        )
    if keys.samples_per_frame > 1 and len(wanted) > 1:
        raise DriverConfigError(
            f"samples_per_frame is for fields of one message; these come from {len(wanted)}"
        )
    counting = None if counter is None else _counter_signal(database, counter, wanted)
    return tuple(_codec(_message(database, name), asked, counting, keys) for name, asked in wanted.items())


def _split(field: str) -> tuple[str, str]:
    message, dot, signal = field.partition(".")
    if not dot:
        raise DriverConfigError(f'"{field}" names no signal; write "Message.Signal"')
    return message, signal


def _counter_signal(database: "Database", counter: str, wanted: dict[str, list[tuple[int, str]]]) -> str:
    message, signal = _split(counter)
    _signal(_message(database, message), signal)
    if message not in wanted:
        raise DriverConfigError(f'the counter "{counter}" lies in a message from which no field is asked')
    return signal


def _message(database: "Database", name: str) -> "Message":
    for message in database.messages:
        if message.name == name:
            return message
    names = ", ".join(message.name for message in database.messages[:20])
    raise DriverConfigError(f'no message is called "{name}"; messages are {names}')


def _signal(message: "Message", name: str) -> "Signal":
    for signal in message.signals:
        if signal.name == name:
            return signal
    names = ", ".join(signal.name for signal in message.signals)
    raise DriverConfigError(f'message "{message.name}" has no signal "{name}"; signals are {names}')


def _codec(
    message: "Message", asked: list[tuple[int, str]], counting: str | None, keys: FrameKeys
) -> MessageCodec:
    samples = tuple(
        tuple(_select(message, column, _signal(message, next_name(name, place))) for column, name in asked)
        for place in range(keys.samples_per_frame)
    )
    number, mask = _identity(message, keys)
    counter = _counter(message, counting, keys) if counting else None
    switches = _switches(message, samples[0])
    check = _check(message, keys)
    pages = pages_of(samples[0])
    lengths = _lengths(message.length)
    return MessageCodec(message.name, number, mask, lengths, samples, pages, counter, switches, check)


def next_name(name: str, place: int) -> str:
    """Return the signal of a frame's later sample: "Force_0" is followed by "Force_1"."""
    if not place:
        return name
    match = re.fullmatch(r"(.*?)(\d+)", name)
    if match is None:
        raise DriverConfigError(
            f'"{name}" ends in no number; samples_per_frame needs such as "{name}_0", "{name}_1"'
        )
    return f"{match[1]}{int(match[2]) + place:0{len(match[2])}d}"


def _check(message: "Message", keys: FrameKeys) -> FrameCheck | None:
    if keys.checksum is None:
        return None
    signal = _signal(message, keys.checksum.signal)
    if signal.multiplexer_ids:
        raise DriverConfigError(
            f'the checksum "{message.name}.{signal.name}" must be in every frame of its message'
        )
    return FrameCheck(keys.checksum, SignalCodec(signal), message.length)


def _switches(
    message: "Message", selected: tuple[Selected, ...]
) -> tuple[tuple[SignalCodec, tuple[int, ...]], ...]:
    names = {switch.name for signal in selected for switch, _ in signal.switches}
    known = {
        name: [s.multiplexer_ids or () for s in message.signals if s.multiplexer_signal == name]
        for name in names
    }
    return tuple(
        (SignalCodec(_signal(message, name)), tuple(number for ids in lists for number in ids))
        for name, lists in known.items()
    )


def _counter(message: "Message", name: str, keys: FrameKeys) -> FrameCounter:
    signal = _signal(message, name)
    if signal.is_float or signal.multiplexer_ids:
        raise DriverConfigError(
            f'the counter "{message.name}.{name}" must be an integer in every frame of its message'
        )
    modulus = keys.counter_modulus or 1 << signal.length
    if modulus > 1 << signal.length:
        raise DriverConfigError(
            f'counter_modulus {modulus}: "{message.name}.{name}" has {signal.length} bits only'
        )
    return FrameCounter(SignalCodec(signal), modulus, keys.samples_per_frame, keys.counter_counts == "frames")


def _select(message: "Message", column: int, signal: "Signal") -> Selected:
    switches = []
    child = signal
    while child.multiplexer_signal and child.multiplexer_ids:
        parent = _signal(message, child.multiplexer_signal)
        switches.append((SignalCodec(parent), tuple(child.multiplexer_ids)))
        child = parent
    return Selected(column, SignalCodec(signal), tuple(switches))


def _lengths(length: int) -> tuple[int, ...]:
    """Return the right data lengths: the message's own or, above eight, the frame length that holds it."""
    return tuple({length, min(size for size in FD_LENGTHS if size >= length)})


def _identity(message: "Message", keys: FrameKeys) -> tuple[int, int]:
    """Return identifier and mask. A message known by group has any priority, and any source unless named."""
    grouped = keys.j1939 == "group" or (keys.j1939 == "auto" and message.protocol == "j1939")
    if not message.is_extended_frame:
        return message.frame_id, EXTENDED | EXTENDED_MASK
    if not grouped:
        return message.frame_id | EXTENDED, EXTENDED | EXTENDED_MASK
    mask = 0x3FFFF00 if (message.frame_id >> 16) & 0xFF >= _J1939_BROADCAST else 0x3FF0000
    number = message.frame_id & mask
    if keys.source_address is not None:
        mask, number = mask | 0xFF, number | keys.source_address
    return number | EXTENDED, EXTENDED | mask


def is_remote(table: FrameTable) -> BoolArray:
    """Tell of each frame whether it asks for data instead of carrying them."""
    remote: BoolArray = (table["id"] & np.uint32(REMOTE)) != 0
    return remote
