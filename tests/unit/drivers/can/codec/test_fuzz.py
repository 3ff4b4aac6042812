"""Frames and daemon text with wrong bits: read as an independent decoder reads them, or rejected for a
reason.

Ten million frames a codec in soak. The text of candump and of slcan adapters: test_can_text.py,
test_slcan_text.py.
"""

import re
from collections.abc import Callable
from typing import Any

import can
import cantools
import numpy as np
import pytest
from can.interfaces.socketcand.socketcand import convert_ascii_message_to_can_message

from drivers.can.bus.bus import message_row
from drivers.can.codec.database import message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.can.codec.frames import FD_LENGTHS, FRAME, MOST_SECONDS, DaemonText, Frames
from drivers.can.codec.layout import FrameKeys
from drivers.port import Counts
from tests.conformance.test_can_conformance import FOLDER

DATABASE: Any = cantools.database.load_file(FOLDER / "rig.dbc")
CHUNK = 10_000
MANY = [20_000, pytest.param(10_000_000, marks=[pytest.mark.soak, pytest.mark.timeout(14_000)])]


def mutated(rng: np.random.Generator, number: int, length: int) -> Frames:
    """Frames of one message with random data, up to three bits of head and data wrong."""
    table = np.zeros(CHUNK, FRAME)
    table["id"], table["length"] = number, length
    table["data"][:, :length] = rng.integers(0, 256, (CHUNK, length), np.uint8)
    cells = table.view(np.uint8).reshape(CHUNK, FRAME.itemsize)
    for _ in range(3):
        struck = np.flatnonzero(rng.random(CHUNK) < 0.4)
        cells[struck, rng.integers(0, 8 + length, len(struck))] ^= (
            1 << rng.integers(0, 8, len(struck))
        ).astype(np.uint8)
    return Frames(table, np.arange(CHUNK))


def plain(data: bytes) -> list[list[float]]:
    row = DATABASE.decode_message("RIG_SAMPLE", data[:8])
    return [[row["Force"], row["X1"]]]


def checked(data: bytes) -> list[list[float]]:
    if sum(data[:7]) % 256 != data[7] or data[0] & 15 == 15:
        return []
    row = DATABASE.decode_message("RIG_CHECKED", data[:8])
    return [[row["Force"], row["X1"]]]


def block(data: bytes) -> list[list[float]]:
    row = DATABASE.decode_message("RIG_BLOCK", data[:26])
    return [[row[f"Force_{n}"], row[f"X1_{n}"]] for n in range(4)]


LAYOUTS: dict[str, tuple[int, int, tuple[int, ...], Callable[[bytes], list[list[float]]], dict[str, Any]]] = {
    "RIG_SAMPLE": (0x100, 8, (8,), plain, {}),
    "RIG_CHECKED": (
        0x105, 8, (8,), checked, {"checksum": {"signal": "Sum", "method": "sum"}, "counter_modulus": 15},
    ),
    "RIG_BLOCK": (0x106, 32, (26, 32), block, {"samples_per_frame": 4}),
}  # fmt: skip


@pytest.mark.parametrize("count", MANY)
@pytest.mark.parametrize("name", LAYOUTS)
def test_mutated_frames_are_read_as_cantools_reads_them_or_rejected(
    rng: np.random.Generator, name: str, count: int
) -> None:
    number, length, lengths, reading, values = LAYOUTS[name]
    ending = "_0" if name == "RIG_BLOCK" else ""
    fields = (f"{name}.Force{ending}", f"{name}.X1{ending}")
    keys = FrameKeys.model_validate({"dbc": "a.dbc", **values})
    counts, samples = Counts(), values.get("samples_per_frame", 1)
    decoder = FrameDecoder(
        message_codecs(DATABASE, fields, f"{name}.Counter", keys), 2, counts, list[str]().append
    )
    mine = errors = delivered = 0
    for _ in range(count // CHUNK):
        frames = mutated(rng, number, length)
        if name == "RIG_CHECKED":  # most of them right
            right = np.flatnonzero(rng.random(CHUNK) < 0.7)
            frames.table["data"][right, 7] = frames.table["data"][right, :7].sum(axis=1)
        got = decoder.decode(frames)
        here = (frames.table["id"] & ~np.uint32(0x40000000)) == number
        whole = (frames.table["id"] == number) & np.isin(frames.table["length"], lengths)
        expected = [row for data in frames.table["data"][whole] for row in reading(data[:32].tobytes())]
        assert got.values.tolist() == expected
        delivered += len(expected)
        mine += int(here.sum())
        errors += int(((frames.table["id"] & 0x20000000) != 0).sum())
    assert counts.received == mine * samples == delivered + counts.rejected.total()
    assert counts.faults.total() >= errors > 0
    assert delivered > 0.2 * count


STANDARD = re.compile(
    rb"< frame ([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8}) (\d{1,10})\.(\d{1,9}) ((?:[0-9A-Fa-f]{2})*) >"
)
MESSAGES = [
    b"< frame 123 23.424242 11223344 >",
    b"< frame 1ABCDEF0 1600000000.000001 00 >",
    b"< frame 7FF 0.1 0102030405060708 >",
    b"< frame 100 5.000000 " + b"AB" * 64 + b" >",
    b"< error 080 12.5 >",
]


@pytest.mark.parametrize("count", MANY)
def test_mutated_daemon_text_is_read_as_python_can_reads_it_or_rejected(
    rng: np.random.Generator, count: int
) -> None:
    text, seen, good, read = DaemonText(), 0, 0, 0
    sound = {message: theirs(message) for message in MESSAGES}
    while seen < count:
        stream = bytearray(b"".join(MESSAGES[i] for i in rng.integers(0, len(MESSAGES), 500).tolist()))
        for place in rng.integers(0, len(stream), 150).tolist():
            stream[place] = (
                int(rng.integers(256)) if rng.random() < 0.5 else int(rng.choice(list(b"<> 0F.framehi")))
            )
        for message in re.findall(rb"[^>]*>", bytes(stream)):
            mine = [row.tobytes() for row in text.feed(message).table]
            agree(message, mine)
            good += message in sound
            read += message in sound and len(mine)
            seen += 1
        text.feed(b">")
        assert len(text._rest) <= 400
    assert read == good > 0.5 * count


def theirs(message: bytes) -> bytes | None:
    try:
        found: can.Message | None = convert_ascii_message_to_can_message(message.decode())
    except (ValueError, IndexError):
        return None
    if found is None:
        return None
    found.is_fd = len(found.data) > 8  # the library leaves it out
    return message_row(found)


def agree(message: bytes, mine: list[bytes]) -> None:
    """Hold two readings against each other: equal, or one of the differences that are known."""
    match = STANDARD.fullmatch(message)
    if match is not None and possible(match):
        assert mine == [theirs(message)]
    elif mine and not mine[0][3] & 0x20:
        # more or fewer spaces than the daemon writes, or rubbish before the message: read all the same
        inner = message[message.rindex(b"<") + 1 : -1].split()
        usual = b"< %s %s %s %s >" % (inner[0], inner[1], inner[2], b"".join(inner[3:]))
        assert mine == [theirs(usual)]
        match = STANDARD.fullmatch(usual)
        assert match is not None
        assert possible(match)
    elif mine:
        assert message[message.rindex(b"<") + 1 :].split()[0].startswith(b"error")


def possible(match: re.Match[bytes]) -> bool:
    """Tell whether a frame can be as the message says; the library takes any number of bits and bytes."""
    bits = 29 if len(match[1]) == 8 else 11
    return (
        int(match[1], 16) < 1 << bits and len(match[4]) // 2 in FD_LENGTHS and int(match[2]) <= MOST_SECONDS
    )
