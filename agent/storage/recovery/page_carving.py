"""Rows read straight from the pages of a file, without its trees: for files whose trees are torn.

Format: https://www.sqlite.org/fileformat2.html, sections 1.6 (leaf pages) and 2.1 (records). Nothing read
here is believed: each row must pass its checksum, and a page that was freed long ago may still hold rows that
were purged.
"""

import struct
from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path

from agent.storage.database.columns import ADDED, TABLES, columns_of
from agent.storage.database.schema import PAGE_SIZE
from agent.storage.database.verify import good_rows
from agent.storage.tables.rows import Row
from agent.storage.tuning import CARVING_ROWS

_LEAF = 0x0D
_WAL_HEADER, _FRAME_HEADER = 32, 24
"""Fixed by SQLite's file format: a table's leaf page, bytes before the log's frames and before each."""
_SCANNED = (
    "rigs", "runs", "series", "fits", "hops", "estimates", "spreads", "alarms", "alarm_events", "health",
    "events", "event_records", "learnt", "hypotheses", "shelves", "annotations", "sites",
    "graphs", "baselines", "forecasts", "covariates", "conditions", "trends",
)  # fmt: skip
_Key = tuple[int, bool]


def _shape(table: str) -> _Key:
    """Return what tells one table's rows from the others': how many cells, and whether any is a text."""
    return len(columns_of(table)), "TEXT" in TABLES[table]


_BY_SHAPE: dict[_Key, list[str]] = {}
for _name in _SCANNED:
    _cells, _texts = _shape(_name)
    for _absent in range(len(ADDED.get(_name, ())) + 1):
        _BY_SHAPE.setdefault((_cells - _absent, _texts), []).append(_name)
_TEXTS = {
    table: [i for i, column in enumerate(TABLES[table].split(", "), 1) if column.endswith(" TEXT NOT NULL")]
    for table in _SCANNED
}
_REALS = {
    table: [
        place
        for place, name in enumerate(columns_of(table))
        if name in ADDED.get(table, ()) or f"{name} REAL" in TABLES[table].split(", ")
    ]
    for table in _SCANNED
}


def scan(path: Path, log: Path) -> Iterator[tuple[str, list[Row]]]:
    """Yield (table, rows that prove themselves) found in the pages of a file and in the frames of its log."""
    yield from _scanned(chain(_pages(path), _frames(log)))


def scan_log(log: Path) -> Iterator[tuple[str, list[Row]]]:
    """Yield (table, rows that prove themselves) found in the frames of a log."""
    yield from _scanned(_frames(log))


def _scanned(pages: Iterable[bytes]) -> Iterator[tuple[str, list[Row]]]:
    waiting: dict[str, list[Row]] = {}
    for page in pages:
        for cells in _rows(page):
            table = _table_of(cells)
            if table is None:
                continue
            waiting.setdefault(table, []).append(_typed(table, _ordered(table, cells)))
            if len(waiting[table]) >= CARVING_ROWS:
                yield table, _proven(table, waiting.pop(table))
    for table, rows in waiting.items():
        yield table, _proven(table, rows)


def _proven(table: str, rows: list[Row]) -> list[Row]:
    return [row for row, right in zip(rows, good_rows(table, rows), strict=True) if right]


def _table_of(cells: list[object]) -> str | None:
    """Return the table that a row may be of; None for none."""
    alike = _BY_SHAPE.get((len(cells), any(isinstance(c, str) for c in cells)), ())
    return next(
        (table for table in alike if all(isinstance(cells[place], str) for place in _TEXTS[table])), None
    )


def _ordered(table: str, cells: list[object]) -> list[object]:
    """Return a row with its checksum last: columns added later stand after it, and earlier rows lack them."""
    added = len(ADDED.get(table, ()))
    crc = len(columns_of(table)) - 1 - added
    later = cells[crc + 1 :]
    return [*cells[:crc], *later, *[None] * (added - len(later)), cells[crc]]


def _typed(table: str, cells: list[object]) -> Row:
    """Return a row as a query would: SQLite stores whole numbers of REAL columns as integers."""
    for place in _REALS[table]:
        value = cells[place]
        if isinstance(value, int):
            cells[place] = float(value)
    return tuple(cells)


def _pages(path: Path) -> Iterator[bytes]:
    if path.exists():
        with path.open("rb") as file:
            yield file.read(PAGE_SIZE)[100:].rjust(PAGE_SIZE, b"\0")
            while page := file.read(PAGE_SIZE):
                yield page


def _frames(log: Path) -> Iterator[bytes]:
    if log.exists():
        with log.open("rb") as file:
            file.seek(_WAL_HEADER)
            while frame := file.read(_FRAME_HEADER + PAGE_SIZE):
                yield frame[_FRAME_HEADER:]


def _rows(page: bytes) -> Iterator[list[object]]:
    """Yield the cells of each row of a leaf page, nothing for others; senseless cells are passed over."""
    if len(page) < PAGE_SIZE or page[0] != _LEAF:
        return
    count = int.from_bytes(page[3:5], "big")
    for number in range(min(count, PAGE_SIZE // 4)):
        place = int.from_bytes(page[8 + 2 * number : 10 + 2 * number], "big")
        try:
            cells = _record(page, place)
        except (IndexError, ValueError, struct.error):
            continue
        if cells is not None:
            yield cells


def _record(page: bytes, place: int) -> list[object] | None:
    """Return the cells of a record with its row's number first; None when it goes on in other pages."""
    size, place = _varint(page, place)
    seq, place = _varint(page, place)
    if size > PAGE_SIZE - 35 or place + size > PAGE_SIZE:
        return None
    head, at = _varint(page, place)
    kinds = []
    end = place + head
    body = place + head
    while at < end:
        kind, at = _varint(page, at)
        kinds.append(kind)
    cells: list[object] = []
    for kind in kinds:
        value, body = _value(page, body, kind)
        cells.append(value)
    if not cells or cells[0] is not None:
        return None
    return [seq, *cells[1:]]


def _varint(page: bytes, place: int) -> tuple[int, int]:
    value = 0
    for length in range(8):
        octet = page[place + length]
        value = value << 7 | octet & 0x7F
        if octet < 0x80:
            return value, place + length + 1
    return value << 8 | page[place + 8], place + 9


_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8}


def _value(page: bytes, place: int, kind: int) -> tuple[object, int]:
    """Return a value of a serial type and where the next begins."""
    if kind in _INTEGERS:
        end = place + _INTEGERS[kind]
        return int.from_bytes(page[place:end], "big", signed=True), end
    if kind == 7:
        return struct.unpack(">d", page[place : place + 8])[0], place + 8
    if kind in {8, 9}:
        return kind - 8, place
    if kind >= 13 and kind % 2:
        end = place + (kind - 13) // 2
        return page[place:end].decode("utf-8"), end
    return None, place + max(0, (kind - 12) // 2)
