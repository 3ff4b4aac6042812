"""Two ways to mark where a frame ends on a serial line: COBS and SLIP. Pure: bytes to bytes.

COBS (Cheshire and Baker 1999) ends frames with a zero and takes every other zero out of them; SLIP (RFC 1055)
ends them with 0xC0 and writes that byte as two where it stands within. Either way a reader is back in step
one end later.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

_END, _ESCAPE = b"\xc0", b"\xdb"
_ESCAPED_END, _ESCAPED_ESCAPE = b"\xdb\xdc", b"\xdb\xdd"
_FULL = 255  # fixed by COBS (Cheshire and Baker 1999): the code of 254 bytes without a zero


def cobs(frame: bytes) -> bytes:
    """Return a frame without its zeros, the end not included."""
    out = bytearray()
    pieces = frame.split(b"\0")
    for number, piece in enumerate(pieces):
        rest = piece
        while len(rest) >= _FULL - 1:
            out += bytes([_FULL]) + rest[: _FULL - 1]
            rest = rest[_FULL - 1 :]
        if rest or number < len(pieces) - 1 or len(piece) < _FULL - 1:
            out += bytes([len(rest) + 1]) + rest
    return bytes(out)


def uncobs(coded: bytes) -> bytes | None:
    """Return the frame that was coded; None where the lengths in it do not add up."""
    out = []
    place = 0
    end = len(coded)
    while place < end:
        code = coded[place]
        after = place + code
        if code == 0 or after > end:
            return None
        out.append(coded[place + 1 : after])
        if code < _FULL and after < end:
            out.append(b"\0")
        place = after
    return b"".join(out)


def slip(frame: bytes) -> bytes:
    """Return a frame with its ends and escapes written as two bytes, the end not included."""
    return frame.replace(_ESCAPE, _ESCAPED_ESCAPE).replace(_END, _ESCAPED_END)


def unslip(coded: bytes) -> bytes | None:
    """Return the frame that was coded; None where an escape stands before a byte that needs none."""
    escapes = coded.count(_ESCAPE)
    if not escapes:
        return coded
    if coded.count(_ESCAPED_END) + coded.count(_ESCAPED_ESCAPE) != escapes:
        return None
    return coded.replace(_ESCAPED_END, _END).replace(_ESCAPED_ESCAPE, _ESCAPE)


@dataclass(frozen=True, slots=True)
class Framing:
    """One way: the byte that ends a frame, and what takes the coding off and puts it on."""

    end: bytes
    decode: Callable[[bytes], bytes | None]
    encode: Callable[[bytes], bytes]


FRAMINGS: Mapping[str, Framing] = {"cobs": Framing(b"\0", uncobs, cobs), "slip": Framing(_END, unslip, slip)}
