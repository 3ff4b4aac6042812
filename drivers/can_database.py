"""What of a DBC file a source needs: its messages, their signals, and how frames are recognised. No bus."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.can_frames import ERROR, EXTENDED, EXTENDED_MASK, FD_LENGTHS, REMOTE, FrameTable
from drivers.can_signals import SignalCodec
from drivers.port import DriverConfigError, FloatArray

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

_J1939_BROADCAST = 0xF0


@dataclass(frozen=True, slots=True)
class Selected:
    """A signal that is asked for, and the multiplexers that must say that it is there: (codec, values) each."""

    column: int
    codec: SignalCodec
    switches: tuple[tuple[SignalCodec, tuple[int, ...]], ...]

    def values(self, table: FrameTable) -> FloatArray:
        """Return the signal's values, (n,), NaN in the frames that carry another one in its place."""
        values = self.codec.values(table)
        for switch, numbers in self.switches:
            values[~_shows(table, switch, numbers)] = np.nan
        return values


@dataclass(frozen=True, slots=True)
class MessageCodec:
    """One message: how its frames are recognised and what is read from them.

    Attributes:
        name: the message's name.
        number, mask: a frame belongs to it when its identifier, flag bits included, equals number within mask.
        lengths: data lengths that are right.
        selected: the signals asked for.
        counter: the signal that counts samples, or None.
        switches: the multiplexers that lead to asked signals, and every number that they can show.
    """

    name: str
    number: int
    mask: int
    lengths: tuple[int, ...]
    selected: tuple[Selected, ...]
    counter: SignalCodec | None
    switches: tuple[tuple[SignalCodec, tuple[int, ...]], ...] = ()

    def mine(self, table: FrameTable) -> NDArray[np.bool_]:
        """Tell of each frame whether it belongs to the message."""
        matching: NDArray[np.bool_] = (table["id"] & np.uint32(self.mask | ERROR)) == np.uint32(self.number)
        return matching

    def all_sound(self, table: FrameTable) -> bool:
        """Tell whether every frame is a whole one of this message: the usual case, told in the shortest way."""
        flags = np.uint32(self.mask | ERROR | REMOTE)
        return bool(((table["id"] & flags) == np.uint32(self.number)).all() and self.right_length(table).all())

    def right_length(self, table: FrameTable) -> NDArray[np.bool_]:
        """Tell of each frame whether it has as many bytes as the message."""
        lengths = table["length"]
        right: NDArray[np.bool_] = lengths == self.lengths[0]
        for other in self.lengths[1:]:
            right |= lengths == other
        return right

    def knows(self, table: FrameTable) -> NDArray[np.bool_]:
        """Tell of each frame whether every multiplexer in it shows a number that the database knows."""
        known = np.ones(len(table), np.bool_)
        for switch, numbers in self.switches:
            known &= _shows(table, switch, numbers)
        return known

    def values(self, table: FrameTable, columns: int) -> FloatArray:
        """Return the asked signals in their columns, (n, columns), NaN elsewhere."""
        shape = (len(table), columns)
        out = np.empty(shape) if len(self.selected) == columns else np.full(shape, np.nan)
        for signal in self.selected:
            out[:, signal.column] = signal.values(table)
        return out


def _shows(table: FrameTable, switch: SignalCodec, numbers: tuple[int, ...]) -> NDArray[np.bool_]:
    return np.isin(switch.bits(table), np.array(numbers, np.uint64))


def load(path: Path) -> "Database":
    """Return the parsed DBC; DriverConfigError when it cannot be read."""
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


def message_codecs(database: "Database", fields: tuple[str, ...], counter: str | None) -> tuple[MessageCodec, ...]:
    """Return the messages that carry the fields ("Message.Signal"); DriverConfigError names what is missing.

    Several messages make one sample when each has a counter signal of the name that `counter` gives.
    """
    wanted: dict[str, list[tuple[int, str]]] = {}
    for column, field in enumerate(fields):
        message, signal = _split(field)
        wanted.setdefault(message, []).append((column, signal))
    if counter is None and len(wanted) > 1:
        raise DriverConfigError(f"fields come from {len(wanted)} messages; a counter in each is needed to join them")
    counting = None if counter is None else _counter_signal(database, counter, wanted)
    return tuple(_codec(_message(database, name), asked, counting) for name, asked in wanted.items())


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


def _codec(message: "Message", asked: list[tuple[int, str]], counting: str | None) -> MessageCodec:
    selected = tuple(_select(message, column, _signal(message, name)) for column, name in asked)
    number, mask = _identity(message)
    counter = _counter(message, counting) if counting else None
    lengths = _lengths(message.length)
    return MessageCodec(message.name, number, mask, lengths, selected, counter, _switches(message, selected))


def _switches(message: "Message", selected: tuple[Selected, ...]) -> tuple[tuple[SignalCodec, tuple[int, ...]], ...]:
    names = {switch.name for signal in selected for switch, _ in signal.switches}
    known = {name: [s.multiplexer_ids or () for s in message.signals if s.multiplexer_signal == name] for name in names}
    return tuple(
        (SignalCodec(_signal(message, name)), tuple(number for ids in lists for number in ids))
        for name, lists in known.items()
    )


def _counter(message: "Message", name: str) -> SignalCodec:
    signal = _signal(message, name)
    if signal.is_float or signal.multiplexer_ids:
        raise DriverConfigError(f'the counter "{message.name}.{name}" must be an integer in every frame of its message')
    return SignalCodec(signal)


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


def _identity(message: "Message") -> tuple[int, int]:
    """Return identifier and mask. A J1939 message comes with any priority and source, and to any destination."""
    if not message.is_extended_frame:
        return message.frame_id, EXTENDED | EXTENDED_MASK
    if message.protocol != "j1939":
        return message.frame_id | EXTENDED, EXTENDED | EXTENDED_MASK
    group = 0x3FFFF00 if (message.frame_id >> 16) & 0xFF >= _J1939_BROADCAST else 0x3FF0000
    return (message.frame_id & group) | EXTENDED, EXTENDED | group


def is_remote(table: FrameTable) -> NDArray[np.bool_]:
    """Tell of each frame whether it asks for data instead of carrying them."""
    remote: NDArray[np.bool_] = (table["id"] & np.uint32(REMOTE)) != 0
    return remote
