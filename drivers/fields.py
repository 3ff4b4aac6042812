"""Packed numbers: how the bytes of many slots or frames become columns of numbers, and back.

A layout is a run of fields without gaps. `Layout.values` reads n slots at once; nothing here knows a bus.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from drivers.port import DriverConfigError, DriverSettings, FloatArray, IntArray

ByteArray = NDArray[np.uint8]
Order = Literal["big", "little"]
NumberType = Literal[
    "int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", "float32", "float64"
]  # fmt: skip


def _not_zero(scale: float) -> float:
    if scale == 0:
        raise ValueError("must not be 0: it would make every sample the same")
    return scale


class FieldSpec(DriverSettings):
    """One number in a slot or frame: value = raw * scale + offset."""

    name: str = Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]{0,63}$")
    type: NumberType
    scale: Annotated[float, AfterValidator(_not_zero)] = 1.0
    offset: float = 0.0

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """The number's type in this machine's byte order."""
        return np.dtype(self.type)

    @property
    def size(self) -> int:
        """Bytes that the number takes."""
        return self.dtype.itemsize

    @property
    def is_integer(self) -> bool:
        """Whether the raw number is an integer."""
        return self.dtype.kind in "iu"

    @property
    def resolution(self) -> float:
        """Smallest step of the value; 0.0 for floats."""
        return abs(self.scale) if self.is_integer else 0.0

    @property
    def modulus(self) -> int:
        """How many values the raw number can take."""
        return 1 << (8 * self.size)


@dataclass(frozen=True)
class Layout:
    """Fields packed one after another.

    Attributes:
        fields: the fields in order.
        byte_order: order of the bytes in a number ("little" for most serial devices, "big" in Modbus
            registers).
        word_order: "little" turns the order of the 16-bit words in a number round. Instruments call the four
            pairs of byte_order and word_order ABCD (big, big), CDAB (big, little), BADC (little, little),
            DCBA (little, big).
        apart: each field fills registers of its own, so that none can straddle them.
    """

    fields: tuple[FieldSpec, ...]
    byte_order: Order = "big"
    word_order: Order = "big"
    apart: bool = False

    def __post_init__(self) -> None:
        swapped = self.word_order == "little" and not self.apart
        if swapped and any(self.offsets[f.name] % 2 for f in self.fields if f.size > 1):
            raise DriverConfigError(
                "with words swapped every field of two bytes or more begins on a register"
            )

    @cached_property
    def offsets(self) -> Mapping[str, int]:
        """Byte at which each field begins."""
        starts = np.cumsum([0, *(field.size for field in self.fields)])
        return {field.name: int(start) for field, start in zip(self.fields, starts, strict=False)}

    @cached_property
    def size(self) -> int:
        """Bytes of a whole slot or frame."""
        return sum(field.size for field in self.fields)

    def field(self, name: str) -> FieldSpec:
        """Return the field of that name; DriverConfigError names those there are."""
        for field in self.fields:
            if field.name == name:
                return field
        names = ", ".join(field.name for field in self.fields)
        raise DriverConfigError(f'no field is called "{name}"; fields are {names}')

    def counter_field(self, name: str) -> FieldSpec:
        """Return the field that counts samples; DriverConfigError unless it is an integer."""
        field = self.field(name)
        if not field.is_integer:
            raise DriverConfigError(f'the counter "{name}" is a {field.type}; a counter must be an integer')
        return field

    def raw(self, slots: ByteArray, name: str) -> NDArray[np.generic]:
        """Return one field's raw numbers, (n,), of slots (n, size)."""
        field = self.field(name)
        start = self.offsets[name]
        columns = slots[:, start : start + field.size]
        if self.word_order == "little" and field.size > 2:
            columns = columns.reshape(len(slots), field.size // 2, 2)[:, ::-1].reshape(len(slots), field.size)
        wire = field.dtype.newbyteorder(">" if self.byte_order == "big" else "<")
        return np.ascontiguousarray(columns).view(wire)[:, 0]

    def values(self, slots: ByteArray, names: Sequence[str]) -> FloatArray:
        """Return (n, m) values of the named fields, scale and offset applied, of slots (n, size)."""
        out = np.empty((len(slots), len(names)))
        for column, name in enumerate(names):
            field = self.field(name)
            with np.errstate(invalid="ignore"):  # any bits may be a float: NaN is judged later
                np.multiply(self.raw(slots, name), field.scale, out=out[:, column], dtype=np.float64)
            if field.offset:
                out[:, column] += field.offset
        return out

    def counter(self, slots: ByteArray, name: str) -> IntArray:
        """Return a counter field's numbers, (n,), in 0 .. modulus - 1 (int64 where the field has 64 bits)."""
        field = self.counter_field(name)
        raw = self.raw(slots, name).astype(np.int64)
        return raw if field.size == 8 else raw % field.modulus

    def resolution(self, names: Sequence[str]) -> tuple[float, ...]:
        """Return the smallest step of each named field."""
        return tuple(self.field(name).resolution for name in names)

    def pack(self, raw: Mapping[str, NDArray[np.generic]]) -> ByteArray:
        """Return slots (n, size) that hold the raw numbers of every field: the inverse of `raw`."""
        columns = [self._pack_field(field, raw[field.name]) for field in self.fields]
        return np.concatenate(columns, axis=1)

    def _pack_field(self, field: FieldSpec, numbers: NDArray[np.generic]) -> ByteArray:
        wire = field.dtype.newbyteorder(">" if self.byte_order == "big" else "<")
        data = np.asarray(numbers).astype(wire).reshape(-1, 1).view(np.uint8)
        if self.word_order == "little" and field.size > 2:
            data = data.reshape(len(data), field.size // 2, 2)[:, ::-1].reshape(len(data), field.size)
        return np.ascontiguousarray(data)


def unique_names(fields: Sequence[FieldSpec]) -> Sequence[FieldSpec]:
    """Return the fields; ValueError when two share a name (for use in pydantic validators)."""
    names = [field.name for field in fields]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"{', '.join(twice)}: named twice; every field needs a name of its own")
    return fields
