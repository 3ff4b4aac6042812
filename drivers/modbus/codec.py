"""Modbus registers and rings of slots: which registers to ask for, and what their bytes mean. Pure: no I/O.

A ring holds the newest samples of a device: sample n lies in slot n mod slots, and an index register counts
the samples written so far. Samples are counted here by an unwrapped number; `Ring.raw` is what the wire
shows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.fields import ByteArray, FieldSpec, Layout, Order
from drivers.modbus.frames import MAX_REGISTERS
from drivers.port import BoolArray, DriverConfigError, IntArray


@dataclass(frozen=True, slots=True)
class Span:
    """Registers asked for in one request, and the samples that lie in them: first .. first + samples - 1."""

    address: int
    count: int
    first: int
    samples: int


@dataclass(frozen=True)
class Ring:
    """Where the samples of a ring lie.

    Attributes:
        address: register at which slot 0 begins.
        slots: number of slots.
        registers: registers of one slot.
        modulus: the index register wraps to 0 after modulus - 1.
    """

    address: int
    slots: int
    registers: int
    modulus: int = 1 << 32

    def __post_init__(self) -> None:
        if not 1 <= self.registers <= MAX_REGISTERS:
            raise DriverConfigError(
                f"a slot of {self.registers} registers does not fit one request; at most 125 do"
            )
        if self.address + self.slots * self.registers > 65536:
            raise DriverConfigError(
                f"ring: {self.slots} slots of {self.registers} registers from {self.address} "
                "end beyond register 65535"
            )

    @property
    def samples_a_request(self) -> int:
        """How many slots fit one request."""
        return MAX_REGISTERS // self.registers

    def unwrap(self, raw: int, near: int) -> int:
        """Return the number congruent to `raw` nearest to `near`: lower when the index ran backwards."""
        ahead = (raw - near) % self.modulus
        return near + ahead - (self.modulus if ahead >= self.modulus // 2 else 0)

    def slot(self, number: int) -> int:
        """Return the slot of a sample."""
        return (number % self.modulus) % self.slots

    def oldest(self, head: int) -> int:
        """Return the oldest sample that can be trusted when `head` samples are written.

        One slot is left out: the device may be writing the next sample into it.
        """
        return max(0, head - self.slots + 1)

    def spans(self, first: int, end: int) -> Iterator[Span]:
        """Yield the requests for samples first .. end - 1: as few as the ring's and index's wrap allow."""
        while first < end:
            slot = self.slot(first)
            to_wrap = min(self.slots - slot, self.modulus - first % self.modulus)
            samples = min(end - first, self.samples_a_request, to_wrap)
            yield Span(self.address + slot * self.registers, samples * self.registers, first, samples)
            first += samples

    def overtaken(self, first: int, samples: int, head: int) -> BoolArray:
        """Tell of each sample if its slot was, or may just be being, overwritten when `head` are written.

        The slot of sample n is next used by sample n + slots, or sooner by the first sample after the index
        wraps that falls into it.
        """
        numbers = np.arange(first, first + samples, dtype=np.int64)
        raw = numbers % self.modulus
        next_turn = numbers - raw + self.modulus
        same_turn = np.where(raw + self.slots < self.modulus, numbers + self.slots, np.iinfo(np.int64).max)
        overwritten: BoolArray = np.minimum(same_turn, next_turn + raw % self.slots) <= head
        return overwritten

    def raw(self, first: int, samples: int) -> IntArray:
        """Return the samples' numbers as the wire counts them."""
        return np.arange(first, first + samples, dtype=np.int64) % self.modulus


def slot_layout(fields: Sequence[FieldSpec], orders: tuple[Order, Order]) -> Layout:
    """Return one slot's layout, in a byte and word order; DriverConfigError unless it fills registers."""
    layout = Layout(tuple(fields), *orders)
    if layout.size % 2:
        raise DriverConfigError(
            f"fields: a slot takes {layout.size} bytes; registers have two, so it must be even"
        )
    return layout


def slots_of(data: ByteArray, layout: Layout) -> ByteArray:
    """Return register bytes as slots, (n, layout.size)."""
    return data.reshape(-1, layout.size)
