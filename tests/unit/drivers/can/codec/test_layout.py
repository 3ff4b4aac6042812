"""What a DBC file does not say: groups, senders, pages, several samples in a frame, checksums, counters."""

from typing import Any

import numpy as np
import pytest
from cantools.database.can import Message, Signal
from pydantic import ValidationError

from drivers.can.codec.database import message_codecs
from drivers.can.codec.decoder import FrameDecoder
from drivers.can.codec.frames import EXTENDED, FD_FLAG, Frames, frames_of, pack_frame
from drivers.can.codec.layout import FrameKeys
from drivers.port import Counts, DriverConfigError
from tests.unit.drivers.can.codec.test_signals import Database, j1939


def keys(**values: Any) -> FrameKeys:
    return FrameKeys.model_validate({"dbc": "a.dbc", **values})


class Decoding:
    def __init__(
        self, messages: list[Message], fields: tuple[str, ...], counter: str | None, **values: Any
    ) -> None:
        self.counts, self.notes = Counts(), list[str]()
        codecs = message_codecs(Database(*messages), fields, counter, keys(**values))  # type: ignore[arg-type]
        self.decoder = FrameDecoder(codecs, len(fields), self.counts, self.notes.append)

    def decode(self, *rows: bytes) -> Any:
        return self.decoder.decode(frames(*rows))


def frames(*rows: bytes) -> Frames:
    return frames_of(rows, np.arange(len(rows)) * 1000)


@pytest.mark.parametrize(
    ("values", "sent", "mine"),
    [
        ({}, 0x0CF00421, True),
        ({"j1939": "exact"}, 0x0CF00421, False),
        ({"j1939": "exact"}, 0x18F00400, True),
        ({"j1939": "group"}, 0x0CF00421, True),
        ({"source_address": 0x21}, 0x0CF00421, True),
        ({"source_address": 0x21}, 0x0CF00422, False),
        ({"source_address": 0x21}, 0x18F00400, False),
    ],
)
def test_j1939_frame_is_told_by_group_sender_or_whole_identifier(
    values: dict[str, Any], sent: int, mine: bool
) -> None:
    decoding = Decoding([j1939(0x18F00400)], ("M.a",), None, **values)
    assert len(decoding.decode(pack_frame(sent | EXTENDED, bytes(8))).values) == mine


def test_plain_extended_message_is_told_by_its_group_where_that_is_asked() -> None:
    message = Message(0x18F00400, "M", 8, [Signal("a", 0, 8)], is_extended_frame=True)
    row = pack_frame(0x0CF00433 | EXTENDED, bytes(8))
    assert len(Decoding([message], ("M.a",), None).decode(row).values) == 0
    assert len(Decoding([message], ("M.a",), None, j1939="group").decode(row).values) == 1


def paged() -> Message:
    """Force on page 0, x on page 1, temperature on page 2; the counter numbers samples."""
    return Message(
        1, "M", 4,
        [
            Signal("which", 0, 8, is_multiplexer=True), Signal("n", 8, 8), Signal("plain", 24, 8),
            Signal("force", 16, 8, multiplexer_ids=[0], multiplexer_signal="which"),
            Signal("x", 16, 8, multiplexer_ids=[1, 5], multiplexer_signal="which"),
            Signal("temp", 16, 8, multiplexer_ids=[2], multiplexer_signal="which"),
        ],
    )  # fmt: skip


def page(which: int, number: int, value: int, plain: int = 9) -> bytes:
    return pack_frame(1, bytes((which, number, value, plain)))


def test_pages_of_a_multiplexed_message_are_joined_by_their_counter() -> None:
    decoding = Decoding([paged()], ("M.x", "M.force", "M.plain"), "M.n")
    rows = [page(which, n, 10 * which + n) for n in range(5) for which in (0, 1, 2)]
    out = decoding.decode(*rows)
    assert out.values.tolist() == [[10 + n, n, 9] for n in range(5)]
    assert out.counter.tolist() == [0, 1, 2, 3, 4]
    assert decoding.counts.received == 5
    assert not decoding.counts.rejected


def test_page_that_never_came_leaves_its_values_missing() -> None:
    decoding = Decoding([paged()], ("M.x", "M.force"), "M.n")
    out = decoding.decode(page(0, 1, 1), page(1, 1, 2), page(5, 2, 3), page(0, 3, 4), page(1, 3, 5))
    np.testing.assert_array_equal(out.values, [[2, 1], [3, np.nan], [5, 4]])


def test_page_that_the_database_does_not_know_is_rejected_once() -> None:
    decoding = Decoding([paged()], ("M.x", "M.force"), "M.n")
    decoding.decode(page(77, 1, 1), page(0, 1, 1), page(1, 1, 2))
    assert decoding.counts.rejected == {"mux": 1}
    assert decoding.counts.received == 2


def test_bad_frame_of_a_paged_message_is_counted_once_not_once_a_page() -> None:
    decoding = Decoding([paged()], ("M.x", "M.force"), "M.n")
    decoding.decode(pack_frame(1, bytes(3)))
    assert decoding.counts.rejected == {"dlc": 1}


def block(samples: int = 4) -> Message:
    """Force and x of several samples in one FD frame, behind one counter."""
    signals = [Signal("n", 0, 16)]
    for place in range(samples):
        signals += [
            Signal(f"force_{place}", 16 + 32 * place, 16, is_signed=True),
            Signal(f"x_{place}", 32 + 32 * place, 16, is_signed=True),
        ]
    return Message(0x20, "B", 18, signals, is_fd=True)


def block_row(number: int, values: list[int], length: int = 20) -> bytes:
    data = number.to_bytes(2, "little") + np.array(values, "<i2").tobytes()
    return pack_frame(0x20, data.ljust(length, b"\0")[:length], FD_FLAG)


def several(**values: Any) -> Decoding:
    return Decoding([block()], ("B.x_0", "B.force_0"), "B.n", samples_per_frame=4, **values)


def test_samples_of_one_frame_come_one_after_another_each_with_its_counter() -> None:
    decoding = several()
    out = decoding.decode(
        block_row(65534, [1, -1, 2, -2, 3, -3, 4, -4]), block_row(2, [5, -5, 6, -6, 7, -7, 8, -8])
    )
    assert out.values.tolist() == [[-n, n] for n in range(1, 9)]
    assert out.counter.tolist() == [65534, 65535, 0, 1, 2, 3, 4, 5]
    assert out.t_ns.tolist() == [0] * 4 + [1000] * 4
    assert decoding.decoder.modulus == 65536
    assert decoding.counts.received == 8


def test_counter_of_frames_numbers_their_samples() -> None:
    decoding = several(counter_counts="frames")
    out = decoding.decode(block_row(65535, [0] * 8), block_row(0, [0] * 8))
    assert out.counter.tolist() == [262140, 262141, 262142, 262143, 0, 1, 2, 3]
    assert decoding.decoder.modulus == 262144


def test_bad_frame_of_several_samples_counts_as_many() -> None:
    decoding = several()
    out = decoding.decode(block_row(0, [0] * 8, length=16), block_row(4, [0] * 8))
    assert len(out.values) == 4
    assert decoding.counts.rejected == {"dlc": 4}
    assert decoding.counts.received == 8


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (("B.n",), "ends in no number"),
        (("B.x_1",), 'has no signal "x_4"'),
        (("B.x_0", "M.a"), "samples_per_frame is for fields of one message"),
    ],
)
def test_several_samples_that_the_database_does_not_hold_are_refused(
    fields: tuple[str, ...], words: str
) -> None:
    other = Message(3, "M", 8, [Signal("n", 0, 16), Signal("a", 16, 8)])
    with pytest.raises(DriverConfigError, match=words):
        Decoding([block(), other], fields, "B.n", samples_per_frame=4)


def test_keys_of_several_samples_without_several_are_refused() -> None:
    with pytest.raises(ValidationError, match="samples_per_frame above 1"):
        keys(counter_counts="frames")


def checked(length: int = 8, where: int = 7, bits: int = 8) -> Message:
    return Message(1, "M", length, [Signal("n", 0, 16), Signal("a", 16, 16), Signal("sum", 8 * where, bits)])


def summed(method: str, data: bytes, **extra: Any) -> Decoding:
    decoding = Decoding([checked()], ("M.a",), "M.n", checksum={"signal": "sum", "method": method, **extra})
    decoding.decode(pack_frame(1, data))
    return decoding


BODY = bytes((1, 0, 7, 0, 0xAB, 0xCD, 0xEF))


@pytest.mark.parametrize(
    ("method", "check", "extra"),
    [
        ("xor", 1 ^ 7 ^ 0xAB ^ 0xCD ^ 0xEF, {}),
        ("xor", 1 ^ 7 ^ 0xAB ^ 0xCD ^ 0xEF ^ 0x12 ^ 0x34, {"data_id": "1234"}),
        ("sum", (1 + 7 + 0xAB + 0xCD + 0xEF) % 256, {}),
        ("CRC-8/SAE-J1850", None, {}),
        ("CRC-8/AUTOSAR", None, {"data_id": "0042"}),
        ("CRC-8/AUTOSAR", None, {"over": "zeroed"}),
    ],
)
def test_checksum_of_every_kind_lets_right_frames_through_and_no_other(
    method: str, check: int | None, extra: dict[str, Any]
) -> None:
    if check is None:
        check = independent_crc(
            method, bytes.fromhex(extra.get("data_id", "")) + BODY + b"\0" * ("over" in extra)
        )
    assert summed(method, BODY + bytes([check]), **extra).counts.rejected == {}
    for wrong in range(256):
        if wrong != check:
            decoding = summed(method, BODY + bytes([wrong]), **extra)
            assert (decoding.counts.rejected, decoding.counts.received) == ({"checksum": 1}, 1)


def independent_crc(method: str, data: bytes) -> int:
    from crccheck import crc

    kind = {"CRC-8/SAE-J1850": crc.Crc8SaeJ1850, "CRC-8/AUTOSAR": crc.Crc8Autosar}[method]
    return int(kind.calc(data))


def test_every_flipped_bit_of_a_checked_frame_is_seen_and_changes_nothing() -> None:
    good = BODY + bytes([independent_crc("CRC-8/AUTOSAR", BODY)])
    for bit in range(64):
        data = bytearray(good)
        data[bit // 8] ^= 1 << bit % 8
        assert summed("CRC-8/AUTOSAR", bytes(data)).counts.rejected == {"checksum": 1}


def test_checksum_of_four_bits_is_taken_as_zero_in_its_own_sum() -> None:
    message = Message(1, "M", 2, [Signal("a", 0, 8), Signal("sum", 8, 4), Signal("n", 12, 4)])
    check = {"signal": "sum", "method": "sum", "over": "zeroed"}
    decoding = Decoding([message], ("M.a",), "M.n", checksum=check)
    out = decoding.decode(pack_frame(1, bytes((3, 0x53))), pack_frame(1, bytes((4, 0x53))))
    assert out.values.tolist() == [[3.0]]
    assert decoding.counts.rejected == {"checksum": 1}
    with pytest.raises(DriverConfigError, match='fills no whole bytes; over = "zeroed"'):
        Decoding([message], ("M.a",), "M.n", checksum={**check, "over": "others"})


@pytest.mark.parametrize(
    ("check", "words"),
    [
        ({"signal": "nosuch", "method": "xor"}, 'has no signal "nosuch"'),
        ({"signal": "n", "method": "xor"}, "has 16 bits; xor makes 8"),
        ({"signal": "sum", "method": "CRC-16/ARC"}, "has 8 bits; CRC-16/ARC makes 16"),
    ],
)
def test_checksum_that_does_not_fit_its_signal_is_refused(check: dict[str, str], words: str) -> None:
    with pytest.raises(DriverConfigError, match=words):
        Decoding([checked()], ("M.a",), "M.n", checksum=check)


def test_checksum_method_that_nobody_knows_names_the_nearest() -> None:
    with pytest.raises(
        ValidationError, match='no CRC is called "CRC-8/SAEJ1850"; did you mean CRC-8/SAE-J1850'
    ):
        keys(checksum={"signal": "sum", "method": "CRC-8/SAEJ1850"})


def test_counter_beyond_its_modulus_is_no_sample() -> None:
    message = Message(1, "M", 2, [Signal("a", 0, 8), Signal("n", 8, 4)])
    decoding = Decoding([message], ("M.a",), "M.n", counter_modulus=15)
    out = decoding.decode(*(pack_frame(1, bytes((n, n))) for n in range(16)))
    assert out.counter.tolist() == list(range(15))
    assert decoding.decoder.modulus == 15
    assert decoding.counts.rejected == {"counter": 1}
    with pytest.raises(DriverConfigError, match="counter_modulus 17"):
        Decoding([message], ("M.a",), "M.n", counter_modulus=17)
