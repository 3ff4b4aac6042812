"""Sparkplug's payload: metrics with their time, as message org.eclipse.tahu.protobuf.Payload.

Of protocol buffers it needs a few kinds of fields, written and read here.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5  # fixed by Protocol Buffers' encoding: wire types
_MOST = 2**64  # fixed by Protocol Buffers' encoding: integers modulo 64 bits


def varint(number: int) -> bytes:
    """Return an integer, modulo 2**64, in groups of seven bits, the lowest first."""
    number %= _MOST
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    out.append(number)
    return bytes(out)


def whole(field: int, number: int) -> bytes:
    """Return a field with an integer; booleans are 0 and 1."""
    return varint(field << 3 | _VARINT) + varint(number)


def real(field: int, number: float) -> bytes:
    """Return a field with a number of double precision."""
    return varint(field << 3 | _EIGHT) + struct.pack("<d", number)


def block(field: int, content: bytes) -> bytes:
    """Return a field with bytes: a text in UTF-8, or a message."""
    return varint(field << 3 | _BYTES) + varint(len(content)) + content


def fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield the fields of a message: number, and an integer or bytes. Raises ValueError."""
    place = 0
    while place < len(data):
        tag, place = _read(data, place)
        kind = tag & 7
        if kind == _VARINT:
            number, place = _read(data, place)
            yield tag >> 3, number
            continue
        if kind == _BYTES:
            length, place = _read(data, place)
        else:
            length = {_EIGHT: 8, _FOUR: 4}.get(kind, -1)
        if length < 0 or place + length > len(data):
            raise ValueError("no protocol buffer: a field is longer than the message")
        yield tag >> 3, data[place : place + length]
        place += length


def _read(data: bytes, place: int) -> tuple[int, int]:
    """Return the integer at a place, and the place behind it."""
    number = shift = 0
    while place < len(data) and shift < 70:
        byte = data[place]
        place += 1
        number |= (byte & 0x7F) << shift
        if byte < 0x80:
            return number % _MOST, place
        shift += 7
    raise ValueError("no protocol buffer: an integer does not end")


INT64: Final = 4
DOUBLE: Final = 10
BOOLEAN: Final = 11
STRING: Final = 12
"""Fixed by Sparkplug 3.0: data types of metrics, as the specification numbers them."""
_PAYLOAD: Final = {"timestamp": 1, "metrics": 2, "seq": 3}
_METRIC: Final = {
    "name": 1, "alias": 2, "timestamp": 3, "datatype": 4, "is_historical": 5, "is_null": 7, "properties": 9,
}  # fmt: skip
_VALUE: Final = {INT64: 11, DOUBLE: 13, BOOLEAN: 14, STRING: 15}
_KEYS, _VALUES, _TYPE, _TEXT = 1, 2, 1, 8  # fixed by Sparkplug 3.0: fields of a set of properties and of one

Value = int | float | bool | str | None


@dataclass(frozen=True, slots=True)
class Metric:
    """One value.

    Attributes:
        datatype: one of those above.
        value: None for null.
        t_ms: when it was so, ms since the epoch.
        name: given in births, and where there is no alias.
        alias: the number that stands for the name after a birth.
        historical: whether it is not the present value.
        unit: given in births; "" for none.
    """

    datatype: int
    value: Value
    t_ms: int
    name: str | None = None
    alias: int | None = None
    historical: bool = False
    unit: str = ""

    def encode(self) -> bytes:
        """Return the metric as a message."""
        out = b"" if self.name is None else block(_METRIC["name"], self.name.encode())
        out += b"" if self.alias is None else whole(_METRIC["alias"], self.alias)
        out += whole(_METRIC["timestamp"], self.t_ms) + whole(_METRIC["datatype"], self.datatype)
        out += whole(_METRIC["is_historical"], 1) if self.historical else b""
        return (
            out + self._value() + (block(_METRIC["properties"], _properties(self.unit)) if self.unit else b"")
        )

    def _value(self) -> bytes:
        if self.value is None:
            return whole(_METRIC["is_null"], 1)
        field = _VALUE[self.datatype]
        if self.datatype == STRING:
            return block(field, str(self.value).encode())
        return real(field, float(self.value)) if self.datatype == DOUBLE else whole(field, int(self.value))


def encode(metrics: Sequence[Metric], t_ms: int | None = None, seq: int | None = None) -> bytes:
    """Return a payload: of a death without time and seq."""
    out = b"" if t_ms is None else whole(_PAYLOAD["timestamp"], t_ms)
    out += b"".join(block(_PAYLOAD["metrics"], metric.encode()) for metric in metrics)
    return out + (b"" if seq is None else whole(_PAYLOAD["seq"], seq))


def commands(payload: bytes) -> dict[str, bool]:
    """Return the metric names of a host's payload, and whether each is true. Raises ValueError."""
    found = {}
    for number, content in fields(payload):
        if number == _PAYLOAD["metrics"] and isinstance(content, bytes):
            metric = dict(fields(content))
            name = metric.get(_METRIC["name"], b"")
            if isinstance(name, bytes):
                found[name.decode(errors="replace")] = metric.get(_VALUE[BOOLEAN]) == 1
    return found


def _properties(unit: str) -> bytes:
    value = whole(_TYPE, STRING) + block(_TEXT, unit.encode())
    return block(_KEYS, b"engUnit") + block(_VALUES, value)
