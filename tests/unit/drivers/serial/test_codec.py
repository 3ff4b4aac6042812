import itertools
import re

import numpy as np
import pytest
from crccheck.crc import Crc16Ibm3740
from pydantic import ValidationError

from drivers import crc
from drivers.fields import FieldSpec, Layout
from drivers.port import Counts, DriverConfigError
from drivers.serial.codec import BinaryDecoder, Frame
from drivers.serial.driver import SerialSettings
from drivers.serial.text import TextDecoder

LAYOUT = Layout((FieldSpec(name="n", type="uint16"), FieldSpec(name="a", type="int32")), "little")
SYNC = b"\xaa\x55"
SIZE = 10
FIELD = [{"name": "a", "type": "int8"}]


def frames(count: int, rng: np.random.Generator, sync: bytes = SYNC) -> list[bytes]:
    raw = {"n": np.arange(count), "a": rng.integers(-(2**31), 2**31, count)}
    return [
        sync + body + Crc16Ibm3740.calc(body).to_bytes(2, "little") for body in map(bytes, LAYOUT.pack(raw))
    ]


def decoder(check: bool = True) -> tuple[BinaryDecoder, Counts]:
    counts = Counts()
    sum_ = crc.by_name("CRC-16/IBM-3740") if check else None
    return BinaryDecoder(SYNC, Frame(LAYOUT, sum_, ("a",), "n", counts)), counts


def numbers(decoder_: BinaryDecoder, pieces: list[bytes]) -> list[int]:
    got = [decoder_.feed(piece)[1] for piece in pieces]
    return [int(n) for part in got if part is not None for n in part]


def independent(stream: bytes) -> list[int]:
    """Read a stream byte by byte as the simplest correct decoder does."""
    out, place = [], 0
    while place + SIZE <= len(stream):
        frame = stream[place : place + SIZE]
        if frame[:2] == SYNC and Crc16Ibm3740.calc(frame[2:8]) == int.from_bytes(frame[8:], "little"):
            out.append(int.from_bytes(frame[2:4], "little"))
            place += SIZE
        else:
            place += 1
    return out


def test_frames_split_at_every_byte_are_read_whole(rng: np.random.Generator) -> None:
    stream = b"".join(frames(4, rng))
    for split in range(len(stream) + 1):
        decoder_, counts = decoder()
        assert numbers(decoder_, [stream[:split], stream[split:]]) == [0, 1, 2, 3]
        assert counts.received == 4
        assert not counts.rejected
        assert not counts.faults


def test_frames_byte_by_byte_are_read_whole(rng: np.random.Generator) -> None:
    decoder_, _ = decoder()
    assert numbers(decoder_, [bytes([byte]) for byte in b"".join(frames(5, rng))]) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("damage", ["flip", "insert", "delete"])
def test_damage_of_any_one_byte_costs_at_most_two_frames(rng: np.random.Generator, damage: str) -> None:
    stream = b"".join(frames(9, rng))
    for place in range(len(stream)):
        data = bytearray(stream)
        if damage == "flip":
            data[place] ^= 0x10
        elif damage == "insert":
            data.insert(place, 0xAA)
        else:
            del data[place]
        decoder_, counts = decoder()
        got = numbers(decoder_, [bytes(data), bytes(SIZE)])
        assert got == independent(bytes(data))
        assert len(got) >= 7
        assert counts.received == len(got) + counts.rejected.total()


def test_frame_with_a_wrong_check_is_rejected_as_crc_and_one_without_sync_as_sync(
    rng: np.random.Generator,
) -> None:
    parts = frames(5, rng)
    decoder_, counts = decoder()
    parts[1] = parts[1][:-1] + bytes([parts[1][-1] ^ 1])
    parts[3] = b"\x00" + parts[3][1:]
    assert numbers(decoder_, parts) == [0, 2, 4]
    assert counts.rejected == {"crc": 1, "sync": 1}
    assert counts.received == 5


def test_stray_bytes_between_frames_are_faults_and_no_samples(rng: np.random.Generator) -> None:
    decoder_, counts = decoder()
    assert numbers(decoder_, [b"\xaa" + part + b"\xaa" for part in frames(5, rng)]) == [0, 1, 2, 3, 4]
    assert counts.rejected.total() == 0
    assert counts.faults["stray bytes"] > 0


def test_line_opened_amid_a_frame_does_not_count_its_piece(rng: np.random.Generator) -> None:
    stream = b"".join(frames(4, rng))
    for skipped in range(1, SIZE):
        decoder_, counts = decoder()
        assert numbers(decoder_, [stream[skipped:]]) == [1, 2, 3]
        assert counts.received == 3


def test_frames_without_check_need_the_next_sync_behind_them(rng: np.random.Generator) -> None:
    body = LAYOUT.pack({"n": np.arange(4), "a": np.array([0x55AA, 1, 2, 3])})
    decoder_, _ = decoder(check=False)
    assert numbers(decoder_, [b"".join(SYNC + bytes(row) for row in body)]) == [0, 1, 2, 3]


def test_garbage_for_long_is_counted_and_not_kept(rng: np.random.Generator) -> None:
    decoder_, counts = decoder()
    for _ in range(50):
        decoder_.feed(rng.integers(0, 256, 10_000, np.uint8).tobytes())
        assert len(decoder_._rest) < SIZE
    assert counts.received == counts.rejected.total()
    assert 49_000 < counts.rejected.total() <= 50_000


@pytest.mark.parametrize(
    "count", [40_000, pytest.param(10_000_000, marks=[pytest.mark.soak, pytest.mark.timeout(3600)])]
)
def test_mutated_frames_are_read_as_an_independent_decoder_reads_them(
    rng: np.random.Generator, count: int
) -> None:
    batch = 2_000
    used = whole = 0
    for _ in range(count // batch):
        parts = frames(batch, rng)
        bad = set(rng.choice(batch, batch // 3, replace=False).tolist())
        for number in bad:
            parts[number] = mutated(parts[number], rng)
        stream = b"".join(parts)
        decoder_, counts = decoder()
        got = numbers(decoder_, [*np_split(stream, rng), bytes(SIZE)])
        assert got == independent(stream)
        assert counts.received == len(got) + counts.rejected.total()
        used += len(set(got) - bad)
        whole += batch - len(bad)
    assert used >= 0.99 * whole


def mutated(frame: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(frame)
    for _ in range(rng.integers(1, 4)):
        kind, place = int(rng.integers(3)), int(rng.integers(len(data)))
        if kind == 0:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            data.insert(place, int(rng.integers(256)))
        elif len(data) > 1:
            del data[place]
    return bytes(data)


def np_split(stream: bytes, rng: np.random.Generator) -> list[bytes]:
    cuts = [0, *sorted(rng.integers(0, len(stream), 9).tolist()), len(stream)]
    return [stream[a:b] for a, b in itertools.pairwise(cuts)]


def text(
    nmea: bool = False, pattern: str | None = None, delimiter: str | None = ","
) -> tuple[TextDecoder, Counts]:
    counts = Counts()
    columns = ("n", "a", "b")
    compiled = re.compile(pattern) if pattern else None
    decoder_ = TextDecoder(columns, delimiter, compiled, nmea, ("b", "a"), "n", counts)
    decoder_.feed(b"\n")
    counts.faults.clear()
    return decoder_, counts


def test_text_lines_are_read_in_pieces_and_with_any_line_end() -> None:
    decoder_, counts = text()
    got = [decoder_.feed(piece) for piece in (b"1,2.5", b",3\r\n2,", b",4\n\n")]
    np.testing.assert_array_equal(np.concatenate([values for values, _ in got]), [[3, 2.5], [4, np.nan]])
    assert [int(n) for _, part in got if part is not None for n in part] == [1, 2]
    assert counts.received == 2


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"1,2\n", "columns"),
        (b"1,2,x\n", "text"),
        (b"1,2,inf\n", "text"),
        (b"1,2,1_000\n", "text"),
        (b"1,2,3\x85\n", "text"),
        (b"1,2," + b"9" * 400 + b"\n", "text"),
        (b"1,2,0x10\n", "text"),
        (b"1,2," + b" " * 1100 + b"3\n", "length"),
        (b"1.5,2,3\n", "counter"),
        (b",1,2\n", "counter"),
    ],
)
def test_text_line_that_is_no_sample_is_rejected_by_its_reason(line: bytes, reason: str) -> None:
    decoder_, counts = text()
    assert len(decoder_.feed(line)[0]) == 0
    assert counts.rejected == {reason: 1}
    assert counts.received == 1


def test_text_with_any_byte_raises_nothing(rng: np.random.Generator) -> None:
    decoder_, counts = text()
    for _ in range(200):
        decoder_.feed(rng.integers(0, 256, 3000, np.uint8).tobytes())
        assert len(decoder_._rest) <= 1024
    assert counts.received == counts.rejected.total()


def test_text_opened_amid_a_line_passes_its_piece_over() -> None:
    counts = Counts()
    decoder_ = TextDecoder(("n", "a", "b"), ",", None, False, ("a",), "n", counts)
    values, _ = decoder_.feed(b"12.5,7,8\n2,3,4\n")
    assert values.tolist() == [[3.0]]
    assert counts.received == 1


def test_nmea_lines_are_read_when_their_checksum_holds() -> None:
    decoder_, counts = text(nmea=True)
    good = b"$RIG,1,2,3*40\r\n"
    values, counter = decoder_.feed(b"noise" + good + good.replace(b"2,3", b"2,4") + b"$RIG,1,2,3\r\n" + good)
    assert counter is not None
    assert values.tolist() == [[3.0, 2.0], [3.0, 2.0]]
    assert counts.rejected == {"checksum": 2}


def test_pattern_with_named_groups_reads_labelled_values() -> None:
    decoder_, counts = text(pattern=r"#(?P<n>\d+) a=(?P<a>\S+) b=(?P<b>\S+)")
    values, _ = decoder_.feed(b"#7 a=1.5 b=-2\nhello\n")
    assert values.tolist() == [[-2.0, 1.5]]
    assert counts.rejected == {"pattern": 1}


def test_text_column_that_does_not_exist_is_refused() -> None:
    with pytest.raises(DriverConfigError, match='no column is called "z"; columns are a'):
        TextDecoder(("a",), ",", None, False, ("z",), None, Counts())


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"format": "binary", "sync": "AA"}, "needs sync and fields"),
        ({"format": "binary", "sync": "", "fields": FIELD}, "at least one byte"),
        ({"format": "binary", "sync": "AG", "fields": FIELD}, "hexadecimal"),
        ({"format": "binary", "sync": "AA", "fields": FIELD, "crc": "CRC-9"}, "no CRC is called"),
        ({"format": "binary", "sync": "AA", "fields": FIELD, "columns": ["a"]}, "has no delimiter"),
        ({"format": "text"}, "needs either columns or a pattern"),
        ({"format": "text", "columns": ["a"], "crc": "CRC-8"}, "has no framing, sync"),
        ({"format": "text", "pattern": "(a"}, "is no pattern"),
        ({"format": "text", "pattern": "a"}, "names no groups"),
    ],
)  # fmt: skip
def test_settings_that_cannot_work_are_refused_in_words(keys: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        SerialSettings.model_validate({"port": "line", **keys})
