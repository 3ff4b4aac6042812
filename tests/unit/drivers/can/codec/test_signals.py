from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.codec.database import message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.can.codec.frames import ERROR, EXTENDED, REMOTE, Frames, frames_of, pack_frame
from drivers.port import Counts, DriverConfigError

SCALES = [1, 2, -3, 10**9, 0.5, 0.1, -0.25, 1e-6, 7.0]
OFFSETS = [0, 5, -40, 0.5, -1e-3, 3.0]


@st.composite
def signals(
    draw: st.DrawFn, first: int, length: int, number: int, mux: tuple[str, int] | None = None
) -> Signal:
    """A signal that fills the bits first .. first + length - 1, numbered as its byte order numbers them."""
    big = draw(st.booleans())
    is_float = length in (16, 32, 64) and draw(st.booleans())
    start = 8 * (first // 8) + 7 - first % 8 if big else first
    return Signal(
        f"s{number}", start, length, "big_endian" if big else "little_endian",
        is_signed=not is_float and draw(st.booleans()),
        conversion=BaseConversion.factory(
            draw(st.sampled_from(SCALES)), draw(st.sampled_from(OFFSETS)), None, is_float
        ),
        multiplexer_ids=[mux[1]] if mux else None, multiplexer_signal=mux[0] if mux else None,
    )  # fmt: skip


@st.composite
def messages(draw: st.DrawFn) -> Message:
    """A message of signals in bytes of their own, so that both byte orders may stand beside each other."""
    size = draw(st.sampled_from([1, 2, 8, 12, 64]))
    muxed = size > 2 and draw(st.booleans())
    found = [Signal("mux", 0, 8, is_multiplexer=True)] if muxed else []
    byte = 1 if muxed else 0
    while byte < size and len(found) < 6:
        width = draw(st.integers(1, min(9, size - byte)))
        bit = draw(st.integers(0, 7))
        length = draw(st.integers(1, min(64, 8 * width - bit)))
        mux = ("mux", draw(st.integers(0, 2))) if muxed and draw(st.booleans()) else None
        found.append(draw(signals(8 * byte + bit, length, len(found), mux)))
        byte += width
    extended = draw(st.booleans())
    return Message(0x123, "M", size, found, is_extended_frame=extended, is_fd=size > 8)


class Database:
    def __init__(self, *messages: Message) -> None:
        self.messages = list(messages)


def table(message: Message, datas: list[bytes]) -> Frames:
    number = message.frame_id | (EXTENDED if message.is_extended_frame else 0)
    return frames_of([pack_frame(number, data) for data in datas], np.arange(len(datas)))


def decoder(
    database: Any, fields: tuple[str, ...], counter: str | None = None
) -> tuple[FrameDecoder, Counts, list[str]]:
    counts, notes = Counts(), []
    return (
        FrameDecoder(message_codecs(database, fields, counter), len(fields), counts, notes.append),
        counts,
        notes,
    )


@settings(max_examples=300)
@given(messages(), st.integers(0, 2**32 - 1))
def test_batch_of_random_messages_equals_cantools_bit_for_bit(message: Message, seed: int) -> None:
    rng = np.random.default_rng(seed)
    datas = [rng.integers(0, 256, message.length, np.uint8).tobytes() for _ in range(8)]
    datas += [b"\xff" * message.length, bytes(message.length)]
    if message.signals[0].name == "mux":
        datas = [bytes([int(rng.integers(0, 3))]) + data[1:] for data in datas]
    names = [signal.name for signal in message.signals]
    codec, _, _ = decoder(Database(message), tuple(f"M.{name}" for name in names))
    got = codec.decode(table(message, datas)).values
    rows = [decoded(message, data) for data in datas]
    expected = np.array([[row.get(name, np.nan) for name in names] for row in rows], float)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(expected))
    sound = ~np.isnan(expected)
    np.testing.assert_array_equal(got[sound].view(np.uint64), expected[sound].view(np.uint64))


def decoded(message: Message, data: bytes) -> dict[str, float]:
    """Return what cantools reads; with a multiplexer's number that selects nothing, what stands beside it."""
    numbers = {number for signal in message.signals for number in signal.multiplexer_ids or ()}
    if message.signals[0].name == "mux" and numbers and data[0] not in numbers:
        plain = [signal for signal in message.signals if not signal.multiplexer_ids]
        for signal in plain:
            signal.is_multiplexer = False
        message = Message(
            message.frame_id, "M", message.length, plain, is_extended_frame=message.is_extended_frame
        )
    return message.decode(data, decode_choices=False)  # type: ignore[return-value]


def sample_message() -> Message:
    return Message(
        0x100, "M", 8, [Signal("n", 0, 16), Signal("a", 16, 16, is_signed=True), Signal("b", 32, 32)]
    )  # fmt: skip


def test_frames_that_are_no_samples_are_rejected_by_their_reasons() -> None:
    codec, counts, _ = decoder(Database(sample_message()), ("M.a",), "M.n")
    good = bytes([1, 0, 0xFE, 0xFF, 0, 0, 0, 0])
    rows = [
        pack_frame(0x100, good),
        pack_frame(0x100, good[:7]),
        pack_frame(0x100, good + bytes(4)),
        pack_frame(0x100 | REMOTE, b"", 0, 8),
        pack_frame(ERROR | 0x40, bytes(8)),
        pack_frame(0x101, good),
        pack_frame(0x100 | EXTENDED, good),
    ]
    out = codec.decode(frames_of(rows, np.arange(len(rows))))
    assert out.values.tolist() == [[-2.0]]
    assert out.counter is not None
    assert out.counter.tolist() == [1]
    assert counts.rejected == {"dlc": 2, "remote frame": 1}
    assert counts.faults == {"bus-off": 1}
    assert counts.received == 4
    assert codec.modulus == 65536


def test_multiplexed_frames_of_other_signals_are_foreign_and_of_unknown_ones_bad() -> None:
    message = Message(
        1, "M", 8,
        [
            Signal("mux", 0, 8, is_multiplexer=True),
            Signal("a", 8, 8, multiplexer_ids=[0], multiplexer_signal="mux"),
            Signal("b", 8, 8, multiplexer_ids=[1], multiplexer_signal="mux"),
        ],
    )  # fmt: skip
    codec, counts, _ = decoder(Database(message), ("M.a",))
    out = codec.decode(table(message, [bytes([which, 9, *bytes(6)]) for which in (0, 1, 2, 0)]))
    assert out.values.tolist() == [[9.0], [9.0]]
    assert counts.rejected == {"mux": 1}
    assert counts.received == 3


def two_messages() -> Database:
    return Database(
        Message(1, "A", 2, [Signal("n", 0, 8), Signal("a", 8, 8)]),
        Message(2, "B", 3, [Signal("n", 0, 8), Signal("b", 8, 8), Signal("c", 16, 8)]),
    )


def parts(*items: tuple[str, int]) -> Frames:
    rows = [
        pack_frame(1, bytes([n % 256, n % 256])) if k == "A" else pack_frame(2, bytes([n % 256, n % 256, 7]))
        for k, n in items
    ]
    return frames_of(rows, np.arange(len(rows)))


def test_parts_of_a_sample_are_joined_whatever_their_order_and_pieces() -> None:
    codec, counts, _ = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    first = codec.decode(parts(("B", 250), ("A", 250), ("A", 251)))
    second = codec.decode(parts(("A", 252), ("B", 251), ("B", 252)))
    assert first.values.tolist() == [[250, 250]]
    assert second.values.tolist() == [[251, 251], [252, 252]]
    assert counts.received == 3


def test_part_that_never_came_leaves_a_missing_value() -> None:
    codec, _, _ = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    out = codec.decode(parts(("A", 1), ("B", 1), ("A", 2), ("A", 3), ("B", 3)))
    np.testing.assert_array_equal(out.values, [[1, 1], [np.nan, 2], [3, 3]])
    assert out.counter is not None
    assert out.counter.tolist() == [1, 2, 3]


def test_message_that_is_silent_holds_samples_back_only_so_long() -> None:
    codec, counts, _ = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    out = codec.decode(parts(*(("A", n) for n in range(100))))
    assert len(out.values) == 100 - 64
    assert counts.received == 36


def test_part_that_comes_late_is_counted_and_changes_nothing() -> None:
    codec, counts, _ = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    codec.decode(parts(("A", 5), ("B", 5), ("A", 6), ("B", 6)))
    assert len(codec.decode(parts(("A", 5))).values) == 0
    assert counts.faults == {"late part": 1}


def test_counters_that_run_back_for_long_begin_a_new_epoch() -> None:
    codec, _, notes = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    codec.decode(parts(*((k, n) for n in range(100) for k in "AB")))
    out = codec.decode(parts(*((k, n) for n in range(80) for k in "AB")))
    assert out.epoch == 1
    assert len(out.values)
    assert "restarted" in notes[0]


@pytest.mark.parametrize("seed", range(5))
def test_joined_samples_over_many_wraps_and_random_pieces_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    codec, counts, _ = decoder(two_messages(), ("B.b", "A.a"), "A.n")
    items = [(k, n) for n in range(1500) for k in rng.permutation(["A", "B"]).tolist()]
    cuts = sorted(rng.integers(0, len(items), 20).tolist())
    got = [
        codec.decode(parts(*items[a:b]))
        for a, b in zip([0, *cuts], [*cuts, len(items)], strict=True)
        if b > a
    ]
    np.testing.assert_array_equal(np.concatenate([g.values for g in got])[:, 0], np.arange(1500) % 256)
    assert counts.received == 1500


@pytest.mark.parametrize(
    ("fields", "counter", "words"),
    [
        (("A.a", "B.b"), None, "a counter in each is needed"),
        (("A.z",), None, 'message "A" has no signal "z"; signals are n, a'),
        (("C.a",), None, 'no message is called "C"; messages are A, B'),
        (("a",), None, 'write "Message.Signal"'),
        (("A.a",), "B.n", "from which no field is asked"),
        (("A.a",), "A.q", 'message "A" has no signal "q"'),
    ],
)
def test_fields_that_the_database_lacks_are_refused_in_words(
    fields: tuple[str, ...], counter: str | None, words: str
) -> None:
    with pytest.raises(DriverConfigError, match=words):
        decoder(two_messages(), fields, counter)


def j1939(frame_id: int) -> Message:
    return Message(frame_id, "M", 8, [Signal("a", 0, 8)], is_extended_frame=True, protocol="j1939")


@pytest.mark.parametrize(("asked", "sent", "mine"), [
    (0x0CF004FE, 0x18F00400, True),
    (0x0CF004FE, 0x0CF00521, False),
    (0x18EF0021, 0x18EF3355, True),
    (0x18EF0021, 0x19EF3355, False),
])  # fmt: skip
def test_j1939_message_is_known_by_its_group_alone(asked: int, sent: int, mine: bool) -> None:
    codec, _, _ = decoder(Database(j1939(asked)), ("M.a",))
    out = codec.decode(frames_of([pack_frame(sent | EXTENDED, bytes(8))], np.arange(1)))
    assert len(out.values) == mine
