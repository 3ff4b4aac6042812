"""Cyclic redundancy checks by their catalogue names, of many frames at once. Pure: no I/O.

A CRC is linear: the check of a frame is the exclusive or of one table entry a byte, the table depending on
the byte's place. So all frames of a batch are checked by one table look-up.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.fields import ByteArray

Words = NDArray[np.uint32]


@dataclass(frozen=True)
class Crc:
    """Parameters of a CRC of 8, 16 or 32 bits: polynomial, start, whether bits are mirrored, final XOR."""

    width: int
    poly: int
    start: int
    mirrored: bool
    final: int

    @property
    def size(self) -> int:
        """Bytes of the check."""
        return self.width // 8

    @cached_property
    def _table(self) -> Words:
        """Return what each byte does to an empty register, (256,)."""
        byte = np.arange(256, dtype=np.uint64)
        top = np.uint64(1 << (self.width - 1))
        register = byte if self.mirrored else byte << np.uint64(self.width - 8)
        for _ in range(8):
            if self.mirrored:
                register = (register >> np.uint64(1)) ^ np.where(
                    register & np.uint64(1), self._mirrored_poly, 0
                )
            else:
                register = (register << np.uint64(1)) ^ np.where(register & top, np.uint64(self.poly), 0)
        return (register & np.uint64((1 << self.width) - 1)).astype(np.uint32)

    @cached_property
    def _mirrored_poly(self) -> np.uint64:
        return np.uint64(_mirror(self.poly, self.width))

    def _step(self, register: Words) -> Words:
        """Return registers after a zero byte."""
        if self.mirrored:
            after: Words = (register >> np.uint32(8)) ^ self._table[register & np.uint32(0xFF)]
        else:
            shifted = (register << np.uint32(8)) & np.uint32((1 << self.width) - 1)
            after = shifted ^ self._table[register >> np.uint32(self.width - 8)]
        return after

    @lru_cache(maxsize=8)  # noqa: B019 (the catalogue's entries live as long as the program)
    def _places(self, length: int) -> tuple[Words, np.uint32]:
        """Return each byte's part in the check by its place, (length, 256), and the check's constant part."""
        places = np.empty((length, 256), np.uint32)
        row = self._table
        for place in reversed(range(length)):
            places[place] = row
            row = self._step(row)
        start = np.array([_mirror(self.start, self.width) if self.mirrored else self.start], np.uint32)
        for _ in range(length):
            start = self._step(start)
        return places, start[0] ^ np.uint32(self.final)

    def of(self, frames: ByteArray) -> Words:
        """Return the check of each frame, (n,), of frames (n, length)."""
        length = frames.shape[1]
        places, constant = self._places(length)
        parts = places[np.arange(length), frames]
        check: Words = np.bitwise_xor.reduce(parts, axis=1) ^ constant
        return check

    def bytes_of(self, frames: ByteArray) -> ByteArray:
        """Return the check of each frame as bytes, low byte first, (n, size)."""
        return self.of(frames).astype("<u4").view(np.uint8).reshape(-1, 4)[:, : self.size]


def _mirror(value: int, width: int) -> int:
    return int(f"{value:0{width}b}"[::-1], 2)


CATALOGUE = {
    "CRC-8/AUTOSAR": Crc(8, 0x2F, 0xFF, False, 0xFF),
    "CRC-8/BLUETOOTH": Crc(8, 0xA7, 0x00, True, 0x00),
    "CRC-8/CDMA2000": Crc(8, 0x9B, 0xFF, False, 0x00),
    "CRC-8/DARC": Crc(8, 0x39, 0x00, True, 0x00),
    "CRC-8/DVB-S2": Crc(8, 0xD5, 0x00, False, 0x00),
    "CRC-8/GSM-A": Crc(8, 0x1D, 0x00, False, 0x00),
    "CRC-8/I-432-1": Crc(8, 0x07, 0x00, False, 0x55),
    "CRC-8/I-CODE": Crc(8, 0x1D, 0xFD, False, 0x00),
    "CRC-8/LTE": Crc(8, 0x9B, 0x00, False, 0x00),
    "CRC-8/MAXIM-DOW": Crc(8, 0x31, 0x00, True, 0x00),
    "CRC-8/NRSC-5": Crc(8, 0x31, 0xFF, False, 0x00),
    "CRC-8/OPENSAFETY": Crc(8, 0x2F, 0x00, False, 0x00),
    "CRC-8/ROHC": Crc(8, 0x07, 0xFF, True, 0x00),
    "CRC-8/SAE-J1850": Crc(8, 0x1D, 0xFF, False, 0xFF),
    "CRC-8/SMBUS": Crc(8, 0x07, 0x00, False, 0x00),
    "CRC-8/WCDMA": Crc(8, 0x9B, 0x00, True, 0x00),
    "CRC-16/ARC": Crc(16, 0x8005, 0x0000, True, 0x0000),
    "CRC-16/CDMA2000": Crc(16, 0xC867, 0xFFFF, False, 0x0000),
    "CRC-16/CMS": Crc(16, 0x8005, 0xFFFF, False, 0x0000),
    "CRC-16/DDS-110": Crc(16, 0x8005, 0x800D, False, 0x0000),
    "CRC-16/DECT-R": Crc(16, 0x0589, 0x0000, False, 0x0001),
    "CRC-16/DECT-X": Crc(16, 0x0589, 0x0000, False, 0x0000),
    "CRC-16/DNP": Crc(16, 0x3D65, 0x0000, True, 0xFFFF),
    "CRC-16/EN-13757": Crc(16, 0x3D65, 0x0000, False, 0xFFFF),
    "CRC-16/GENIBUS": Crc(16, 0x1021, 0xFFFF, False, 0xFFFF),
    "CRC-16/GSM": Crc(16, 0x1021, 0x0000, False, 0xFFFF),
    "CRC-16/IBM-3740": Crc(16, 0x1021, 0xFFFF, False, 0x0000),
    "CRC-16/IBM-SDLC": Crc(16, 0x1021, 0xFFFF, True, 0xFFFF),
    "CRC-16/KERMIT": Crc(16, 0x1021, 0x0000, True, 0x0000),
    "CRC-16/LJ1200": Crc(16, 0x6F63, 0x0000, False, 0x0000),
    "CRC-16/M17": Crc(16, 0x5935, 0xFFFF, False, 0x0000),
    "CRC-16/MAXIM-DOW": Crc(16, 0x8005, 0x0000, True, 0xFFFF),
    "CRC-16/MCRF4XX": Crc(16, 0x1021, 0xFFFF, True, 0x0000),
    "CRC-16/MODBUS": Crc(16, 0x8005, 0xFFFF, True, 0x0000),
    "CRC-16/NRSC-5": Crc(16, 0x080B, 0xFFFF, True, 0x0000),
    "CRC-16/OPENSAFETY-A": Crc(16, 0x5935, 0x0000, False, 0x0000),
    "CRC-16/OPENSAFETY-B": Crc(16, 0x755B, 0x0000, False, 0x0000),
    "CRC-16/PROFIBUS": Crc(16, 0x1DCF, 0xFFFF, False, 0xFFFF),
    "CRC-16/SPI-FUJITSU": Crc(16, 0x1021, 0x1D0F, False, 0x0000),
    "CRC-16/T10-DIF": Crc(16, 0x8BB7, 0x0000, False, 0x0000),
    "CRC-16/TELEDISK": Crc(16, 0xA097, 0x0000, False, 0x0000),
    "CRC-16/UMTS": Crc(16, 0x8005, 0x0000, False, 0x0000),
    "CRC-16/USB": Crc(16, 0x8005, 0xFFFF, True, 0xFFFF),
    "CRC-16/XMODEM": Crc(16, 0x1021, 0x0000, False, 0x0000),
    "CRC-32/AIXM": Crc(32, 0x814141AB, 0x00000000, False, 0x00000000),
    "CRC-32/AUTOSAR": Crc(32, 0xF4ACFB13, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "CRC-32/BASE91-D": Crc(32, 0xA833982B, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "CRC-32/BZIP2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0xFFFFFFFF),
    "CRC-32/CD-ROM-EDC": Crc(32, 0x8001801B, 0x00000000, True, 0x00000000),
    "CRC-32/CKSUM": Crc(32, 0x04C11DB7, 0x00000000, False, 0xFFFFFFFF),
    "CRC-32/ISCSI": Crc(32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "CRC-32/ISO-HDLC": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "CRC-32/JAMCRC": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0x00000000),
    "CRC-32/MEF": Crc(32, 0x741B8CD7, 0xFFFFFFFF, True, 0x00000000),
    "CRC-32/MPEG-2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0x00000000),
    "CRC-32/XFER": Crc(32, 0x000000AF, 0x00000000, False, 0x00000000),
}
_ALIASES = {
    "CRC-8": "CRC-8/SMBUS",
    "CRC-8/MAXIM": "CRC-8/MAXIM-DOW",
    "CRC-16": "CRC-16/ARC",
    "CRC-16/AUTOSAR": "CRC-16/IBM-3740",
    "CRC-16/CCITT-FALSE": "CRC-16/IBM-3740",
    "CRC-16/CCITT-TRUE": "CRC-16/KERMIT",
    "CRC-16/BUYPASS": "CRC-16/UMTS",
    "CRC-16/X-25": "CRC-16/IBM-SDLC",
    "CRC-32": "CRC-32/ISO-HDLC",
    "CRC-32C": "CRC-32/ISCSI",
    "CRC-32/POSIX": "CRC-32/CKSUM",
}


def by_name(name: str) -> Crc:
    """Return a CRC by its catalogue name or a usual alias; ValueError names the nearest ones."""
    key = _ALIASES.get(name.upper(), name.upper())
    if key not in CATALOGUE:
        from difflib import get_close_matches

        near = get_close_matches(key, [*CATALOGUE, *_ALIASES], n=3, cutoff=0.5)
        hint = f"; did you mean {' or '.join(near)}?" if near else ""
        raise ValueError(f'no CRC is called "{name[:40]}"{hint}')
    return CATALOGUE[key]
