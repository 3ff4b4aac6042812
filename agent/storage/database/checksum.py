"""Row checksums: CRC-32 (the one of zlib), so that a flipped bit in a stored row is seen.

SQLite's own checks look at the structure of a page, not at what the rows say; most single-bit faults of flash
pass them. Every table of the store therefore carries a column `crc`, the last one, made of the columns before
it.
"""

import zlib
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.storage.tuning import CHECKSUM_FEW, CHECKSUM_ROWS

_POLYNOMIAL = 0xEDB88320  # fixed by CRC-32 of ISO 3309

Cell = int | float | str | None


def _byte_table() -> NDArray[np.uint32]:
    """Return what one byte does to the register (the classical table of 256 words)."""
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> 1) ^ np.uint32(_POLYNOMIAL), table >> 1).astype(np.uint32)
    return table


@lru_cache(maxsize=8)
def _position_tables(width: int) -> tuple[NDArray[np.uint32], int]:
    """Return one table a byte position and the checksum of `width` zero bytes.

    A CRC is affine over GF(2): the checksum of a row is that of a row of zeros, xor what each byte does
    alone.
    """
    step = _byte_table()
    tables = np.empty((width, 256), dtype=np.uint32)
    tables[-1] = step
    for position in range(width - 2, -1, -1):
        later = tables[position + 1]
        tables[position] = (later >> 8) ^ step[later & 0xFF]
    return tables, zlib.crc32(bytes(width))


def column_crc(*columns: NDArray[np.int64] | NDArray[np.float64], later: int = 0) -> NDArray[np.int32]:
    """Return the checksum of each row: zlib.crc32 of its columns, 8 bytes each, little-endian, in order.

    Args:
        columns: (n,) int64 or float64 each; NULL is float NaN (any NaN counts as the same one).
        later: how many of the last columns, float64, came with a later version: a row in which they are NULL
            has the checksum that it had before, so that no row is written again for their sake.

    Returns:
        (n,) the checksum as a signed 32-bit number, which SQLite keeps in four bytes.
    """
    if not later:
        return _crc(columns)
    first = columns[:-later]
    bare = np.all([np.isnan(column) for column in columns[-later:]], axis=0)
    if not bare.any():
        return _crc(columns)
    out = _crc(first)
    if not bare.all():
        out[~bare] = _crc([column[~bare] for column in columns])
    return out


def _crc(columns: Sequence[NDArray[np.int64] | NDArray[np.float64]]) -> NDArray[np.int32]:
    rows = len(columns[0])
    packed = np.empty((rows, len(columns)), dtype="<i8")
    for place, column in enumerate(columns):
        packed[:, place] = _bits(column)
    if rows <= CHECKSUM_FEW:
        return np.array([zlib.crc32(row.data) for row in packed], dtype=np.uint32).view(np.int32)
    table, start = _position_tables(8 * len(columns))
    told = np.flatnonzero(np.bitwise_or.reduce(packed, axis=0, initial=0).view(np.uint8)).tolist()
    out = np.full(rows, start, dtype=np.uint32)
    for first in range(0, rows, CHECKSUM_ROWS):
        part = np.ascontiguousarray(packed[first : first + CHECKSUM_ROWS].view(np.uint8).T)
        for position in told:  # a byte that is 0 in all rows changes none: most are
            out[first : first + CHECKSUM_ROWS] ^= table[position].take(part[position])
    return out.view(np.int32)


def _bits(column: NDArray[np.int64] | NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the eight bytes of each number; every NaN as the usual one."""
    if column.dtype == np.float64:
        plain: NDArray[np.int64] = np.where(np.isnan(column), np.nan, column).astype("<f8").view("<i8")
        return plain
    return column.astype("<i8")


def row_crc(cells: Iterable[Cell]) -> int:
    """Return the checksum of one row of mixed types, as a signed 32-bit number.

    Integers in decimal, floats in hexadecimal notation, texts as they are, NULL as a zero byte; joined by
    0x1f.
    """
    number = zlib.crc32("\x1f".join(_text(cell) for cell in cells).encode("utf-8", "surrogatepass"))
    return number - (1 << 32) if number >= 1 << 31 else number


def with_crc(cells: Sequence[Cell]) -> tuple[Cell, ...]:
    """Return a row of mixed types: its cells, and behind them their checksum."""
    return (*cells, row_crc(cells))


def checked(row: Sequence[Any] | None) -> tuple[Any, ...] | None:
    """Return the cells of a row before its checksum; None where that is wrong, and without a row."""
    if row is None or row_crc(row[:-1]) != row[-1]:
        return None
    return tuple(row[:-1])


def _text(cell: Cell) -> str:
    if cell is None:
        return "\0"
    return float(cell).hex() if isinstance(cell, float) else str(cell)
