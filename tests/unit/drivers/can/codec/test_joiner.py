"""Samples in several frames: joined as a plain loop joins them, whatever comes late, twice, or from a device
anew."""

from collections.abc import Sequence

import numpy as np
import pytest

from drivers.can.codec.joiner import Joiner, Part
from drivers.port import Counts, FloatArray, IntArray

COLUMNS = (np.array([0]), np.array([1, 2]))
MODULUS = 256
PENDING, LATE_BEFORE_RESTART = 64, 50


class PlainJoiner:
    """The same, a reading at a time."""

    def __init__(self) -> None:
        self.epoch, self.received, self.late = 0, 0, 0
        self.restart()

    def restart(self) -> None:
        self.rows: dict[int, FloatArray] = {}
        self.times: dict[int, int] = {}
        self.newest: dict[int, int] = {}
        self.emitted: int | None = None
        self.near: int | None = None
        self.run = 0

    def join(self, parts: Sequence[Part]) -> list[tuple[int, list[float], int, int]]:
        if self.near is None and parts:
            self.near = int(min(parts, key=lambda part: int(part.t_ns[0])).keys[0])
        for part in parts:
            before = self.newest.get(part.number, self.near or 0)
            for key in unwrapped(part.keys, before):
                self.take(part, key)
        keys = sorted(self.rows)
        final = min(self.newest.values()) if len(self.newest) == len(COLUMNS) else None
        whole = [
            k for i, k in enumerate(keys) if (final is not None and k <= final) or len(keys) - i > PENDING
        ]
        if whole:
            self.emitted = self.near = whole[-1]
        self.received += len(whole)
        return [(k % MODULUS, self.rows.pop(k).tolist(), self.times.pop(k), self.epoch) for k in whole]

    def take(self, part: Part, numbered: tuple[int, int]) -> None:
        place, key = numbered
        if self.emitted is not None and key <= self.emitted:
            self.late += 1
            self.run += 1
            if self.run > LATE_BEFORE_RESTART:
                self.epoch += 1
                self.restart()
                self.near = key
            return
        self.run = 0
        row = self.rows.setdefault(key, np.full(3, np.nan))
        for column, value in zip(part.columns.tolist(), part.values[place].tolist(), strict=True):
            row[column] = row[column] if np.isnan(value) else value
        self.times.setdefault(key, int(part.t_ns[place]))
        self.newest[part.number] = max(self.newest.get(part.number, key), key)


def unwrapped(keys: IntArray, before: int) -> list[tuple[int, int]]:
    found, half = [], MODULUS // 2
    for place, key in enumerate(keys.tolist()):
        before += (key - before + half) % MODULUS - half
        found.append((place, before))
    return found


def stream(rng: np.random.Generator, trouble: float) -> list[list[Part]]:
    """Batches of two messages: frames lost, late, twice, out of order, without some reading, and a device
    anew."""
    batches, first, t_ns = [], int(rng.integers(1000)), 10**18
    for _ in range(60):
        if rng.random() < 0.3 * trouble:
            first -= int(rng.integers(1, 120))
        count, parts = int(rng.integers(0, 90)), []
        for number, columns in enumerate(COLUMNS):
            keys = np.arange(first, first + count)
            keys = keys[rng.random(len(keys)) >= 0.1 * trouble]
            if len(keys) and rng.random() < trouble:
                keys = np.insert(keys, int(rng.integers(len(keys))), keys[int(rng.integers(len(keys)))])
            if rng.random() < 0.3 * trouble:
                keys = rng.permutation(keys)
            values = rng.normal(size=(len(keys), len(columns)))
            values[rng.random(values.shape) < 0.1 * trouble] = np.nan
            if len(keys):
                times = t_ns + np.arange(len(keys)) * 1000 + number
                parts.append(Part(number, keys % MODULUS, values, columns, times))
        first, t_ns = first + count, t_ns + 10**8
        batches.append(parts)
    return batches


@pytest.mark.parametrize("trouble", [0.0, 0.2, 1.0])
def test_parts_are_joined_as_a_plain_loop_joins_them(rng: np.random.Generator, trouble: float) -> None:
    epochs = late = received = 0
    for _ in range(20):
        counts, notes = Counts(), list[str]()
        ours, plain = Joiner(len(COLUMNS), 3, MODULUS, counts, notes.append), PlainJoiner()
        for parts in stream(rng, trouble):
            found, wanted = ours.join(parts), plain.join(parts)
            assert found.counter is not None
            assert found.counter.tolist() == [row[0] for row in wanted]
            assert found.t_ns.tolist() == [row[2] for row in wanted]
            np.testing.assert_array_equal(found.values, np.array([row[1] for row in wanted]).reshape(-1, 3))
            assert found.epoch == plain.epoch
        assert counts.received == plain.received
        assert counts.faults["late part"] == plain.late
        assert len(notes) == plain.epoch
        epochs, late, received = epochs + plain.epoch, late + plain.late, received + plain.received
    assert received > 10_000
    assert (late > 0) == (trouble > 0)
    assert (epochs > 0) == (trouble > 0)
