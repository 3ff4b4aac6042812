import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.modbus.codec import Ring
from drivers.port import DriverConfigError


class PlayedRing:
    """A device of plain Python that writes samples one by one, its index wrapping."""

    def __init__(self, ring: Ring, start: int) -> None:
        self.ring = ring
        self.number = start
        self.slots = [-1] * ring.slots

    def write(self, count: int) -> None:
        for _ in range(count):
            self.slots[(self.number % self.ring.modulus) % self.ring.slots] = self.number
            self.number += 1


@given(st.integers(2, 40), st.integers(0, 300), st.integers(0, 60), st.integers(0, 60))
def test_overtaken_names_exactly_the_samples_whose_slot_was_or_is_being_written(
    slots: int, start: int, first_go: int, second_go: int
) -> None:
    ring = Ring(0, slots, 3, modulus=128)
    device = PlayedRing(ring, start)
    device.write(first_go)
    first, head = max(start, device.number - slots), device.number
    device.write(second_go)
    held = list(device.slots)
    held[(device.number % ring.modulus) % slots] = -1  # the next sample may just be being written
    expected = [held[ring.slot(number)] != number for number in range(first, head)]
    assert ring.overtaken(first, head - first, device.number).tolist() == expected


@given(st.integers(2, 90), st.integers(1, 125), st.integers(0, 400), st.integers(0, 200))
def test_spans_cover_every_sample_once_within_the_ring(
    slots: int, registers: int, first: int, count: int
) -> None:
    ring = Ring(100, slots, registers, modulus=256)
    spans = list(ring.spans(first, first + count))
    assert [n for span in spans for n in range(span.first, span.first + span.samples)] == [
        *range(first, first + count)
    ]
    for span in spans:
        assert span.count == span.samples * registers <= 125
        assert 100 <= span.address <= span.address + span.count <= 100 + slots * registers
        assert span.address == 100 + ring.slot(span.first) * registers


def test_spans_are_as_few_as_the_request_size_and_the_wrap_allow() -> None:
    ring = Ring(16, 1024, 3)
    assert [span.samples for span in ring.spans(1000, 1090)] == [24, 41, 25]


@pytest.mark.parametrize(
    ("raw", "near", "expected"), [(5, 250, 261), (250, 261, 250), (7, 7, 7), (130, 261, 386)]
)
def test_unwrap_gives_the_nearest_number(raw: int, near: int, expected: int) -> None:
    assert Ring(0, 10, 1, modulus=256).unwrap(raw, near) == expected


def test_raw_numbers_wrap_with_the_index() -> None:
    np.testing.assert_array_equal(Ring(0, 8, 1).raw(2**32 - 1, 2), [2**32 - 1, 0])


def test_ring_beyond_the_last_register_is_refused() -> None:
    with pytest.raises(DriverConfigError, match="beyond register 65535"):
        Ring(60000, 2000, 3)
