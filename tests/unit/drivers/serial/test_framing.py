"""The two codings against the published packages of others, and against each other."""

import numpy as np
import pytest
import sliplib
from cobs import cobs as published_cobs

from drivers.serial.framing import FRAMINGS, cobs, slip, uncobs, unslip

# the examples of the COBS paper and of its encyclopaedia article
GOLDEN = {
    "00": "01 01",
    "00 00": "01 01 01",
    "00 11 00": "01 02 11 01",
    "11 22 00 33": "03 11 22 02 33",
    "11 22 33 44": "05 11 22 33 44",
    "11 00 00 00": "02 11 01 01 01",
}


@pytest.mark.parametrize("frame", GOLDEN)
def test_cobs_of_the_books_examples_is_theirs(frame: str) -> None:
    assert cobs(bytes.fromhex(frame)) == bytes.fromhex(GOLDEN[frame])
    assert uncobs(bytes.fromhex(GOLDEN[frame])) == bytes.fromhex(frame)


@pytest.mark.parametrize("length", [0, 1, 7, 253, 254, 255, 508, 509, 600])
@pytest.mark.parametrize("zeros", [0.0, 0.1, 0.9])
def test_codings_of_any_frame_are_read_back_by_us_and_by_others(
    rng: np.random.Generator, length: int, zeros: float
) -> None:
    frame = np.where(rng.random(length) < zeros, 0, rng.integers(1, 256, length)).astype(np.uint8).tobytes()
    frame = frame.replace(b"\x07", b"\xc0").replace(b"\x08", b"\xdb")
    assert (
        published_cobs.decode(cobs(frame))
        == frame
        == uncobs(cobs(frame))
        == uncobs(published_cobs.encode(frame))
    )
    assert (
        sliplib.decode(slip(frame))
        == frame
        == unslip(slip(frame))
        == unslip(sliplib.encode(frame).strip(b"\xc0"))
    )
    for name, framing in FRAMINGS.items():
        assert framing.end not in framing.encode(frame), name


def their_cobs(coded: bytes) -> bytes | None:
    try:
        return bytes(published_cobs.decode(coded))
    except published_cobs.DecodeError:
        return None


def their_slip(coded: bytes) -> bytes | None:
    try:
        return bytes(sliplib.decode(coded))
    except sliplib.ProtocolError:
        return None


@pytest.mark.parametrize("count", [20_000, pytest.param(1_000_000, marks=pytest.mark.soak)])
def test_codings_of_random_bytes_are_taken_or_refused_as_others_do(
    rng: np.random.Generator, count: int
) -> None:
    few = np.array([1, 2, 3, 4, 0xDB, 0xDC, 0xDD, 0xFF], np.uint8)
    for _ in range(count):
        coded = rng.choice(few, int(rng.integers(1, 9))).tobytes()
        assert uncobs(coded) == their_cobs(coded), coded.hex(" ")
        assert unslip(coded) == their_slip(coded), coded.hex(" ")
