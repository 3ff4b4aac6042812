import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.fields import FieldSpec, Layout
from drivers.port import DriverConfigError

CODES = {
    "int8": "b", "int16": "h", "int32": "i", "int64": "q", "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q",
    "float32": "f", "float64": "d",
}  # fmt: skip
KINDS = st.lists(st.sampled_from(sorted(CODES)), min_size=1, max_size=6)


def layout_of(kinds: list[str], order: str) -> Layout:
    return Layout(tuple(FieldSpec(name=f"f{i}", type=kind) for i, kind in enumerate(kinds)), order)


@given(KINDS, st.sampled_from(["big", "little"]), st.integers(0, 2**32 - 1))
def test_layout_of_random_bytes_reads_what_struct_reads(kinds: list[str], order: str, seed: int) -> None:
    layout = layout_of(kinds, order)
    slots = np.random.default_rng(seed).integers(0, 256, (5, layout.size), np.uint8)
    expected = [struct.unpack((">" if order == "big" else "<") + "".join(CODES[k] for k in kinds), s) for s in slots]
    for column, field in enumerate(layout.fields):
        raw = layout.raw(slots, field.name)
        np.testing.assert_array_equal(raw, np.array([row[column] for row in expected], field.dtype))


@given(KINDS, st.sampled_from(["big", "little"]), st.integers(0, 2**32 - 1))
def test_pack_of_what_was_read_gives_the_bytes_back(kinds: list[str], order: str, seed: int) -> None:
    layout = layout_of([k for k in kinds if not k.startswith("float")] or ["uint8"], order)
    slots = np.random.default_rng(seed).integers(0, 256, (5, layout.size), np.uint8)
    np.testing.assert_array_equal(layout.pack({f.name: layout.raw(slots, f.name) for f in layout.fields}), slots)


def test_word_order_little_swaps_registers_and_keeps_their_bytes() -> None:
    layout = Layout((FieldSpec(name="a", type="uint32"), FieldSpec(name="b", type="uint64")), "big", "little")
    slots = np.array([[3, 4, 1, 2, 7, 8, 5, 6, 3, 4, 1, 2]], np.uint8)
    assert layout.raw(slots, "a")[0] == 0x01020304
    assert layout.raw(slots, "b")[0] == 0x0102030405060708
    np.testing.assert_array_equal(
        layout.pack({"a": np.array([0x01020304]), "b": np.array([0x0102030405060708])}), slots
    )


def test_word_order_little_with_a_field_across_registers_is_refused() -> None:
    with pytest.raises(DriverConfigError, match="begins on a register"):
        Layout((FieldSpec(name="a", type="uint8"), FieldSpec(name="b", type="uint32")), "big", "little")


@pytest.mark.parametrize("words", ["big", "little"])
def test_no_slots_give_no_values(words: str) -> None:
    layout = Layout((FieldSpec(name="a", type="int32"), FieldSpec(name="b", type="float64")), "big", words)
    assert layout.values(np.empty((0, 12), np.uint8), ["b", "a"]).shape == (0, 2)
    assert layout.counter(np.empty((0, 12), np.uint8), "a").shape == (0,)
    assert layout.pack({"a": np.empty(0), "b": np.empty(0)}).shape == (0, 12)


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
