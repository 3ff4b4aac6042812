"""Frames that an end divides, whole and damaged, against packages of others that take the coding off."""

import itertools

import numpy as np
import pytest
import sliplib
from cobs import cobs as published_cobs
from crccheck.crc import Crc16Ibm3740
from pydantic import ValidationError

from drivers import crc
from drivers.fields import FieldSpec, Layout
from drivers.port import Counts
from drivers.serial.codec import Frame
from drivers.serial.delimited import EndedDecoder
from drivers.serial.driver import SerialSettings
from drivers.serial.framing import FRAMINGS

LAYOUT = Layout((FieldSpec(name="n", type="uint16"), FieldSpec(name="a", type="int32")), "little")
SIZE = 8
BOTH = pytest.mark.parametrize("name", sorted(FRAMINGS))


def frames(name: str, count: int, rng: np.random.Generator) -> list[bytes]:
    raw = {"n": np.arange(count), "a": rng.integers(-(2**31), 2**31, count)}
    bodies = [body + Crc16Ibm3740.calc(body).to_bytes(2, "little") for body in map(bytes, LAYOUT.pack(raw))]
    return [coded(name, body) for body in bodies]


def coded(name: str, body: bytes) -> bytes:
    return published_cobs.encode(body) + b"\0" if name == "cobs" else sliplib.encode(body) + b"\xc0"


def decoder(name: str, check: bool = True) -> tuple[EndedDecoder, Counts]:
    counts = Counts()
    sum_ = crc.by_name("CRC-16/IBM-3740") if check else None
    return EndedDecoder(FRAMINGS[name], Frame(LAYOUT, sum_, ("a",), "n", counts)), counts


def numbers(decoder_: EndedDecoder, pieces: list[bytes]) -> list[int]:
    got = [decoder_.feed(piece)[1] for piece in pieces]
    return [int(n) for part in got if part is not None for n in part]


def independent(name: str, stream: bytes) -> list[int]:
    """Read a stream by the others' packages, one end after another; what follows the last end is no frame
    yet."""
    out = []
    for piece in stream.split(b"\0" if name == "cobs" else b"\xc0")[:-1]:
        try:
            body = published_cobs.decode(piece) if name == "cobs" else sliplib.decode(piece)
        except (published_cobs.DecodeError, sliplib.ProtocolError):
            continue
        if len(body) == SIZE and Crc16Ibm3740.calc(body[:6]) == int.from_bytes(body[6:], "little"):
            out.append(int.from_bytes(body[:2], "little"))
    return out


@BOTH
def test_frames_split_at_every_byte_are_read_whole(rng: np.random.Generator, name: str) -> None:
    stream = b"".join(frames(name, 4, rng))
    for split in range(len(stream) + 1):
        decoder_, counts = decoder(name)
        assert numbers(decoder_, [stream[:split], stream[split:]]) == [0, 1, 2, 3]
        assert counts.received == 4
        assert not counts.rejected
        assert not counts.faults


@BOTH
@pytest.mark.parametrize("damage", ["flip", "insert", "delete"])
def test_damage_of_any_one_byte_costs_at_most_two_frames(
    rng: np.random.Generator, name: str, damage: str
) -> None:
    stream = b"".join(frames(name, 9, rng))
    for place in range(len(stream)):
        data = bytearray(stream)
        if damage == "flip":
            data[place] ^= 0x10
        elif damage == "insert":
            data.insert(place, 0)
        else:
            del data[place]
        decoder_, counts = decoder(name)
        got = numbers(decoder_, [bytes(data)])
        assert got == independent(name, bytes(data))
        assert len(got) >= 7
        assert counts.received == len(got) + counts.rejected.total()


@BOTH
def test_bad_frames_are_rejected_each_by_its_reason(rng: np.random.Generator, name: str) -> None:
    parts = frames(name, 6, rng)
    spoilt = bytearray(LAYOUT.pack({"n": np.array([1]), "a": np.array([5])}).tobytes() + b"\0\1")
    parts[1] = coded(name, bytes(spoilt))
    parts[3] = coded(name, bytes(9))
    decoder_, counts = decoder(name)
    assert numbers(decoder_, parts) == [0, 2, 4, 5]
    assert counts.rejected == {"crc": 1, "length": 1}
    assert counts.received == 6


def test_coding_that_does_not_add_up_is_rejected_as_such(rng: np.random.Generator) -> None:
    for name, wrong in (("cobs", b"\xf0\1\2\3\4\5\6\7\x08\0"), ("slip", b"\1\2\3\xdb\1\2\3\4\5\xc0")):
        parts = frames(name, 3, rng)
        decoder_, counts = decoder(name)
        assert numbers(decoder_, [parts[0], wrong, parts[2]]) == [0, 2]
        assert counts.rejected == {"coding": 1}


@BOTH
def test_line_opened_amid_a_frame_does_not_count_its_piece(rng: np.random.Generator, name: str) -> None:
    parts = frames(name, 4, rng)
    for skipped in range(1, len(parts[0]) - 1):
        decoder_, counts = decoder(name)
        assert numbers(decoder_, [parts[0][skipped:], *parts[1:]]) == [1, 2, 3]
        assert counts.received == 3
        assert counts.faults["stray bytes"] > 0


@BOTH
def test_garbage_for_long_is_counted_and_not_kept(rng: np.random.Generator, name: str) -> None:
    decoder_, counts = decoder(name)
    for low in (0, 1):  # with ends in it, and one endless frame
        for _ in range(25):
            decoder_.feed(rng.integers(low, 0xC0, 10_000, np.uint8).tobytes())
            assert len(decoder_._rest) <= 2 * SIZE + 2
    assert counts.received == counts.rejected.total()
    assert 40_000 < counts.rejected.total() <= 62_500
    good = frames(name, 3, rng)
    assert numbers(decoder_, [coded(name, b"")[-1:], *good]) == [0, 1, 2]


SOAK = [pytest.mark.soak, pytest.mark.timeout(3600)]


@BOTH
def test_garbage_without_an_end_takes_the_next_frame_along_however_it_is_cut(
    rng: np.random.Generator, name: str
) -> None:
    first, second, third = frames(name, 3, rng)
    garbage = b"\x05" * 60
    for pieces in ([first, garbage + second, third], [first, garbage[:30], garbage[30:], second, third]):
        decoder_, counts = decoder(name)
        assert numbers(decoder_, pieces) == [0, 2]
        assert counts.received == 2 + counts.rejected.total()


@BOTH
@pytest.mark.parametrize("count", [20_000, pytest.param(10_000_000, marks=SOAK)])
def test_mutated_frames_are_read_as_others_read_them(rng: np.random.Generator, name: str, count: int) -> None:
    batch, used, whole = 2_000, 0, 0
    good = frames(name, batch, rng)
    for _ in range(count // batch):
        parts = good.copy()
        bad = rng.choice(batch, batch // 3, replace=False).tolist()
        for number in bad:
            parts[number] = mutated(parts[number], rng)
        stream = b"".join(parts)
        decoder_, counts = decoder(name)
        cuts = [0, *sorted(rng.integers(0, len(stream), 9).tolist()), len(stream)]
        got = numbers(decoder_, [stream[a:b] for a, b in itertools.pairwise(cuts)])
        assert got == independent(name, stream)
        assert counts.received == len(got) + counts.rejected.total()
        used += len(set(got) - set(bad))
        whole += batch - len(bad)
    assert used >= 0.8 * whole  # an end that is lost takes the next frame along


def mutated(frame: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(frame)
    for kind, place, value in rng.integers(
        (0, 0, 0), (3, len(data), 256), (int(rng.integers(1, 4)), 3)
    ).tolist():
        if kind == 0:
            data[place % len(data)] ^= 1 << value % 8
        elif kind == 1:
            data.insert(place, value)
        elif len(data) > 1:
            del data[place % len(data)]
    return bytes(data)


FIELD = [{"name": "a", "type": "int8"}]


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"format": "binary", "framing": "cobs"}, "needs sync and fields, or a framing"),
        (
            {"format": "binary", "framing": "slip", "sync": "AA", "fields": FIELD},
            'framing "slip" has no sync',
        ),
        ({"format": "binary", "framing": "hdlc", "fields": FIELD}, "sync.*cobs.*slip"),
        ({"format": "text", "columns": ["a"], "framing": "cobs"}, "has no framing"),
        ({"format": "text", "pattern": r"(?P<a>a+)+b"}, "can take very long"),
    ],
)
def test_settings_that_cannot_work_are_refused_in_words(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SerialSettings.model_validate({"port": "line", **keys})
