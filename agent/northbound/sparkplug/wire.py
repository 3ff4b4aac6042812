"""Protocol buffers on the wire: the few kinds of fields that Sparkplug's payload has, written and read.

A field is its number and wire type (0 varint, 1 eight bytes, 2 length and bytes, 5 four bytes) and then its
value. https://protobuf.dev/programming-guides/encoding
"""

import struct
from collections.abc import Iterator

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
_MOST = 2**64


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
