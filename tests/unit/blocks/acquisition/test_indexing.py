"""Which sample is it: wraps, gaps, repeats, restarts, silences, time stamps that do not quite fit."""

import numpy as np
import pytest

from agent.blocks.acquisition.indexing import Clock, Indexer, Origin
from drivers.port import IntArray, SampleBlock

MS = 1_000_000


def block(
    counter: object = None,
    t_ns: object = None,
    arrival_ms: float = 0.0,
    epoch: int = 0,
    rows: int | None = None,
) -> SampleBlock:
    def integers(values: object) -> IntArray | None:
        return None if values is None else np.asarray(values, dtype=np.int64)

    counts, stamps = integers(counter), integers(t_ns)
    length = next(len(a) for a in (counts, stamps, np.zeros(rows or 0)) if a is not None)
    return SampleBlock(np.zeros((length, 1)), round(arrival_ms * MS), counts, stamps, epoch)


def indexer(clock: Clock = "counter", modulus: int | None = None) -> Indexer:
    return Indexer(clock, 1000.0, modulus=modulus)


@pytest.mark.parametrize(
    ("bits", "first"), [(63, 0), (63, 2**62 - 50), (64, 0), (64, 2**63 - 50), (64, 2**64 - 50)]
)
def test_indexer_counter_of_all_bits_that_numbers_have_is_counted(bits: int, first: int) -> None:
    """A field of 64 bits is read as a signed number, which goes on below zero where it has no room above."""
    it = indexer(modulus=2**bits)
    for start in (0, 100, 250):
        raw = np.array([(first + start + n) % 2**64 for n in range(100)], np.uint64).astype(np.int64)
        index, kept = it.take(block(raw, arrival_ms=start + 100.0))
        assert kept.all()
        assert index.tolist() == list(range(start, start + 100))
    assert not it.rejected


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_indexer_counter_wrap_goes_on_counting(bits: int) -> None:
    modulus = 2**bits
    it = indexer(modulus=modulus)
    first = np.arange(modulus - 50, modulus + 50) % modulus
    index, kept = it.take(block(first))
    assert kept.all()
    assert index.tolist() == list(range(100))
    index, kept = it.take(block([50, 51, 53], arrival_ms=3))
    assert index.tolist() == [100, 101, 103]
    assert kept.all()
    assert not it.rejected


def test_indexer_duplicate_and_backwards_are_refused_and_counted() -> None:
    it = indexer(modulus=256)
    index, kept = it.take(block([10, 11, 11, 12, 9, 13]))
    assert index[kept].tolist() == [0, 1, 2, 3]
    assert it.rejected == {"duplicate": 1, "backwards": 1}
    index, kept = it.take(block([13, 14], arrival_ms=1))
    assert index[kept].tolist() == [4]
    assert it.rejected == {"duplicate": 2, "backwards": 1}


@pytest.mark.parametrize(
    ("silence_ms", "step"), [(100, 101), (200, 201), (256, 257), (1000, 1001), (10_000, 10_001)]
)
def test_indexer_silence_longer_than_half_a_wrap_is_told_by_the_clock(silence_ms: int, step: int) -> None:
    it = indexer(modulus=256)
    it.take(block(np.arange(100), arrival_ms=100))
    index, kept = it.take(block([(99 + step) % 256], arrival_ms=100 + silence_ms + 3))
    assert kept.all()
    assert index.tolist() == [99 + step]


@pytest.mark.parametrize("rows", [130, 200, 255, 256, 300, 700])
def test_indexer_block_longer_than_half_a_wrap_is_no_silence(rows: int) -> None:
    """What a reader finds after a stall of its machine: many samples at once, none of them lost."""
    it = indexer(modulus=256)
    it.take(block(np.arange(100), arrival_ms=100))
    index, kept = it.take(block(np.arange(100, 100 + rows) % 256, arrival_ms=100 + rows))
    assert kept.all()
    assert index.tolist() == list(range(100, 100 + rows))
    index, _ = it.take(block([(100 + rows) % 256], arrival_ms=101 + rows))
    assert index.tolist() == [100 + rows]


def test_indexer_silence_before_a_long_block_is_told_by_the_clock() -> None:
    it = indexer(modulus=256)
    it.take(block(np.arange(100), arrival_ms=100))
    lost, rows = 1000, 200
    came = np.arange(100 + lost, 100 + lost + rows)
    index, kept = it.take(block(came % 256, arrival_ms=100 + lost + rows + 3))
    assert kept.all()
    assert index.tolist() == came.tolist()


def test_indexer_short_counter_read_unpunctually_loses_nothing(rng: np.random.Generator) -> None:
    """Four bits at 1 kHz wrap each 16 ms: a thread that waited for its turn is no silence."""
    it, first, found = indexer(modulus=16), 0, []
    while first < 5000:
        rows = int(rng.integers(1, 60))
        number = np.arange(first, first + rows)
        index, kept = it.take(block(number % 16, arrival_ms=float(first + rows + rng.uniform(0, 45))))
        assert kept.all()
        found += index.tolist()
        first += rows
    assert found == list(range(first))


def test_indexer_new_epoch_goes_on_after_the_time_that_passed() -> None:
    it = indexer(modulus=2**32)
    it.take(block(np.arange(5000, 5100), arrival_ms=100))
    index, kept = it.take(block([0, 1, 2], arrival_ms=600, epoch=1))
    assert kept.all()
    assert np.diff(index).tolist() == [1, 1]
    assert 590 <= index[0] <= 610
    assert it.restarts == 1


def test_indexer_device_that_counts_from_behind_has_restarted() -> None:
    it = indexer(modulus=2**32)
    it.take(block(np.arange(90_000, 90_100), arrival_ms=100))
    index, kept = it.take(block(np.arange(101), arrival_ms=300))
    assert not kept.any()
    assert it.restarts == 1
    index, kept = it.take(block(np.arange(101, 110), arrival_ms=310))
    assert kept.all()
    assert index[0] > 99
    assert it.rejected["backwards"] == 101


def test_indexer_device_clock_rounds_to_the_nearest_sample() -> None:
    it = indexer("device")
    jitter = np.array([0, 0.4, -0.4, 0.3, -0.2, 0.49])
    index, kept = it.take(block(t_ns=7 * MS + np.rint((np.arange(6) + jitter) * MS).astype(np.int64)))
    assert kept.all()
    assert index.tolist() == list(range(6))
    index, kept = it.take(block(t_ns=[7 * MS + 5 * MS, 7 * MS + 9 * MS, 7 * MS + 8 * MS]))
    assert index[kept].tolist() == [9]
    assert it.rejected == {"duplicate": 1, "backwards": 1}


def test_indexer_device_clock_since_the_epoch_keeps_its_precision() -> None:
    start = 1_760_000_000 * 10**9
    it = indexer("device")
    index, _ = it.take(block(t_ns=start + np.arange(0, 3_000_000_000, MS)))
    assert index.tolist() == list(range(3000))


def test_indexer_uniform_counts_rows_whatever_the_stamps_say() -> None:
    it = indexer("uniform")
    assert it.take(block(t_ns=[5, 5, 3]))[0].tolist() == [0, 1, 2]
    assert it.take(block(rows=2))[0].tolist() == [3, 4]


def test_indexer_counter_falls_back_to_stamps_then_to_rows() -> None:
    assert indexer().take(block(t_ns=[0, MS, 4 * MS]))[0].tolist() == [0, 1, 4]
    assert indexer().take(block(rows=3))[0].tolist() == [0, 1, 2]


def test_indexer_two_sources_of_one_origin_agree() -> None:
    origin = Origin()
    one, two = (Indexer("counter", 1000.0, origin, modulus=256) for _ in range(2))
    assert one.take(block([250, 251, 252]))[0].tolist() == [0, 1, 2]
    assert two.take(block([251, 252, 253]))[0].tolist() == [1, 2, 3]


def counted(origin: Origin, every: int, modulus: int, restart: int, first: int = 0) -> dict[int, int]:
    """Read a device each `every` ms, 1 kHz, which counts anew from `restart` on; return the index of each new
    count."""
    it, found = Indexer("counter", 1000.0, origin, modulus=modulus), {}
    for start in range(0, restart + 1000, every):
        number = np.arange(start, start + every)
        count = np.where(number < restart, number + first, number - restart)
        index, kept = it.take(block(count % modulus, arrival_ms=float(start + every)))
        found |= (
            dict(zip(count[kept].tolist(), index[kept].tolist(), strict=True)) if start >= restart else {}
        )
    return found


@pytest.mark.parametrize(("first", "modulus"), [(0, 65536), (42_000, 65536), (2000, 4096)])
def test_indexer_two_sources_that_count_anew_at_once_agree_again(first: int, modulus: int) -> None:
    """Read each 50 and each 100 ms; a 16-bit counter may fall back or leap ahead, as the shorter way is."""
    origin = Origin(shared=True)
    one, two = counted(origin, 50, modulus, 8000, first), counted(origin, 100, 2**32, 8000, first)
    common = one.keys() & two.keys()
    assert len(common) > 700
    assert {one[count] - two[count] for count in common} == {0}
    assert one[300 if 300 in one else 500] == 8000 + (300 if 300 in one else 500)


def test_indexer_source_that_counts_anew_alone_goes_on_by_the_clock_and_parts_from_the_others() -> None:
    origin = Origin(shared=True)
    one, two = (Indexer("counter", 1000.0, origin, modulus=2**32) for _ in range(2))
    for it in (one, two):
        it.take(block(np.arange(8000), arrival_ms=8000))
    index, _ = one.take(block(np.arange(50), arrival_ms=8300, epoch=1))
    assert index[-1] == 7999 + 300
    assert one.generation != two.generation
    index, _ = two.take(block(np.arange(100), arrival_ms=9000, epoch=1))
    assert index[-1] == 7999 + 1000
    assert one.generation != two.generation


def test_indexer_empty_block_changes_nothing() -> None:
    it = indexer(modulus=16)
    it.take(block([3, 4]))
    index, kept = it.take(block([]))
    assert len(index) == len(kept) == 0
    assert it.take(block([5]))[0].tolist() == [2]
