import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.fields import FieldSpec, Layout
from drivers.port import DriverConfigError

CODES = {
    "int8": "b", "int16": "h", "int32": "i", "int64": "q", "uint8": "B", "uint16": "H", "uint32": "I",
    "uint64": "Q",
    "float32": "f", "float64": "d",
}  # fmt: skip
KINDS = st.lists(st.sampled_from(sorted(CODES)), min_size=1, max_size=6)


def layout_of(kinds: list[str], order: str) -> Layout:
    return Layout(tuple(FieldSpec(name=f"f{i}", type=kind) for i, kind in enumerate(kinds)), order)


@given(KINDS, st.sampled_from(["big", "little"]), st.integers(0, 2**32 - 1))
def test_layout_of_random_bytes_reads_what_struct_reads(kinds: list[str], order: str, seed: int) -> None:
    layout = layout_of(kinds, order)
    slots = np.random.default_rng(seed).integers(0, 256, (5, layout.size), np.uint8)
    expected = [
        struct.unpack((">" if order == "big" else "<") + "".join(CODES[k] for k in kinds), s) for s in slots
    ]
    for column, field in enumerate(layout.fields):
        raw = layout.raw(slots, field.name)
        np.testing.assert_array_equal(raw, np.array([row[column] for row in expected], field.dtype))


@given(KINDS, st.sampled_from(["big", "little"]), st.integers(0, 2**32 - 1))
def test_pack_of_what_was_read_gives_the_bytes_back(kinds: list[str], order: str, seed: int) -> None:
    layout = layout_of([k for k in kinds if not k.startswith("float")] or ["uint8"], order)
    slots = np.random.default_rng(seed).integers(0, 256, (5, layout.size), np.uint8)
    np.testing.assert_array_equal(
        layout.pack({f.name: layout.raw(slots, f.name) for f in layout.fields}), slots
    )


def test_word_order_little_swaps_registers_and_keeps_their_bytes() -> None:
    layout = Layout((FieldSpec(name="a", type="uint32"), FieldSpec(name="b", type="uint64")), "big", "little")
    slots = np.array([[3, 4, 1, 2, 7, 8, 5, 6, 3, 4, 1, 2]], np.uint8)
    assert layout.raw(slots, "a")[0] == 0x01020304
    assert layout.raw(slots, "b")[0] == 0x0102030405060708
    np.testing.assert_array_equal(
        layout.pack({"a": np.array([0x01020304]), "b": np.array([0x0102030405060708])}), slots
    )


def test_words_swapped_with_a_field_across_registers_is_refused() -> None:
    with pytest.raises(DriverConfigError, match="begins on a register"):
        Layout((FieldSpec(name="a", type="uint8"), FieldSpec(name="b", type="uint32")), "big", "little")


@pytest.mark.parametrize("words", ["big", "little"])
def test_no_slots_give_no_values(words: str) -> None:
    layout = Layout((FieldSpec(name="a", type="int32"), FieldSpec(name="b", type="float64")), "big", words)
    assert layout.values(np.empty((0, 12), np.uint8), ["b", "a"]).shape == (0, 2)
    assert layout.counter(np.empty((0, 12), np.uint8), "a").shape == (0,)
    assert layout.pack({"a": np.empty(0), "b": np.empty(0)}).shape == (0, 12)


BYTES = bytes.fromhex("0102030405060708")
ORDERS = {
    ("big", "big"): ("0102", "01020304", "0102030405060708"),
    ("big", "little"): ("0102", "03040102", "0708050603040102"),
    ("little", "little"): ("0201", "02010403", "0201040306050807"),
    ("little", "big"): ("0201", "04030201", "0807060504030201"),
}
"""As instruments call them: ABCD, CDAB, BADC, DCBA."""


@pytest.mark.parametrize("orders", sorted(ORDERS))
@pytest.mark.parametrize("bits", [16, 32, 64])
def test_number_in_each_order_of_bytes_and_words_is_read_and_written(
    bits: int, orders: tuple[str, str]
) -> None:
    layout = Layout((FieldSpec(name="a", type=f"uint{bits}"),), *orders)
    wire = bytes.fromhex(dict(zip((16, 32, 64), ORDERS[orders], strict=True))[bits])
    slots = np.frombuffer(wire, np.uint8)[None]
    number = int.from_bytes(BYTES[: bits // 8], "big")
    assert int(layout.raw(slots, "a")[0]) == number
    np.testing.assert_array_equal(layout.pack({"a": np.array([number], np.uint64)}), slots)


def test_float32_is_scaled_as_a_float64_whatever_its_value() -> None:
    rng = np.random.default_rng(1)
    numbers = (rng.uniform(-10.0, 10.0, 4655) * 10.0 ** rng.integers(-6, 6, 4655)).astype(np.float32)
    layout = Layout((FieldSpec(name="a", type="float32", scale=0.01, offset=0.25),))
    got = layout.values(numbers.astype(">f4").view(np.uint8).reshape(-1, 4), ["a"])[:, 0]
    assert got.tolist() == [float(number) * 0.01 + 0.25 for number in numbers]


def test_values_apply_scale_then_offset() -> None:
    layout = Layout((FieldSpec(name="a", type="int16", scale=0.5, offset=-3.0),))
    assert layout.values(np.array([[0xFF, 0xFE]], np.uint8), ["a"])[0, 0] == -4.0


def test_counter_of_a_signed_field_is_read_modulo_its_range() -> None:
    layout = Layout((FieldSpec(name="n", type="int8"),))
    assert layout.counter(np.array([[0x7F], [0x80], [0xFF]], np.uint8), "n").tolist() == [127, 128, 255]


def test_unknown_field_is_refused_and_the_fields_are_named() -> None:
    with pytest.raises(DriverConfigError, match='no field is called "z"; fields are f0, f1'):
        layout_of(["int8", "int8"], "big").field("z")


def test_float_counter_is_refused() -> None:
    with pytest.raises(DriverConfigError, match="must be an integer"):
        layout_of(["float32"], "big").counter_field("f0")


@pytest.mark.parametrize("scale", [float("nan"), float("inf")])
def test_scale_that_is_not_finite_is_refused(scale: float) -> None:
    with pytest.raises(ValidationError):
        FieldSpec(name="a", type="int8", scale=scale)
