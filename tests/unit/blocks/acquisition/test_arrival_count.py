"""Samples that nothing but their arrival orders: jitter is neither repeat nor gap, what is lost is a gap."""

import numpy as np
import pytest

from agent.blocks.acquisition.indexing import Indexer
from drivers.port import FloatArray, SampleBlock


def ns(seconds: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.rint(seconds * 1e9).astype(np.int64) + 10**12


def polled(rate: float, answered_s: FloatArray, gather_s: float = 0.02) -> tuple[Indexer, list[int]]:
    """Deliver polls as the Modbus driver does: those of 20 ms at once, each with its own receipt."""
    indexer = Indexer("arrival", rate)
    numbers: list[int] = []
    for turn in np.split(answered_s, np.flatnonzero(np.diff(answered_s // gather_s)) + 1):
        block = SampleBlock(np.zeros((len(turn), 1)), int(ns(turn[-1:])[0]), received_ns=ns(turn))
        index, kept = indexer.take(block)
        numbers += index[kept].tolist()
    return indexer, numbers


def streamed(
    rate: float, taken_s: FloatArray, rng: np.random.Generator, gather_s: float = 0.05
) -> tuple[Indexer, list[int]]:
    """Deliver a line that flows as the serial driver does: what has come is read about each 50 ms, in one
    block."""
    indexer, done, now = Indexer("arrival", rate), 0, float(taken_s[0])
    numbers: list[int] = []
    while (now := now + gather_s + float(rng.exponential(1e-3))) < taken_s[-1]:
        ready = int(np.searchsorted(taken_s, now))
        if ready > done:
            index, kept = indexer.take(SampleBlock(np.zeros((ready - done, 1)), int(ns(np.array([now]))[0])))
            numbers += index[kept].tolist()
            done = ready
    return indexer, numbers


@pytest.mark.parametrize("rate", [1.0, 10.0, 50.0, 60.0, 200.0])
@pytest.mark.parametrize("ppm", [-1000, 0, 1000])
def test_arrival_polls_that_jitter_are_all_numbered_one_by_one(rate: float, ppm: int) -> None:
    rng = np.random.default_rng(int(rate) + ppm + 1000)
    count = int(max(40 * rate, 100))
    answered = np.arange(count) / rate * (1 + ppm * 1e-6) + rng.exponential(min(0.04 / rate, 2e-3), count)
    indexer, numbers = polled(rate, answered)
    assert numbers == list(range(count))
    assert not indexer.rejected


@pytest.mark.parametrize("rate", [20.0, 100.0, 200.0, 400.0])
@pytest.mark.parametrize("ppm", [-500, -3, 3, 500])
def test_arrival_line_that_flows_is_numbered_one_by_one(rate: float, ppm: int) -> None:
    rng = np.random.default_rng(int(rate) + ppm + 1000)
    taken = np.arange(int(120 * rate)) / rate * (1 + ppm * 1e-6)
    indexer, numbers = streamed(rate, taken, rng)
    assert len(taken) - 30 < len(numbers)
    assert numbers == list(range(len(numbers)))
    assert not indexer.rejected


@pytest.mark.parametrize("lost", [1, 2, 7, 25, 500])
def test_arrival_polls_that_were_lost_leave_a_gap_of_their_length_where_they_were(lost: int) -> None:
    rng = np.random.default_rng(lost)
    kept = np.r_[0:400, 400 + lost : 900 + lost]
    indexer, numbers = polled(50.0, kept / 50.0 + rng.exponential(5e-4, len(kept)))
    assert numbers == kept.tolist()
    assert not indexer.rejected


@pytest.mark.parametrize("lost", [5, 20, 300])
def test_arrival_of_a_line_that_paused_leaves_a_gap_soon_after(lost: int) -> None:
    rng = np.random.default_rng(lost)
    kept = np.r_[0:2000, 2000 + lost : 6000 + lost]
    indexer, numbers = streamed(200.0, kept / 200.0, rng)
    steps = np.diff(numbers)
    assert len(numbers) > len(kept) - 20
    assert abs(int((steps - 1).sum()) - lost) <= 1
    assert all(2000 - 15 <= place <= 2000 + 300 for place in np.flatnonzero(steps > 1).tolist())
    assert not indexer.rejected


def test_arrival_a_reader_that_was_held_up_makes_no_gap_of_a_line_that_was_buffered() -> None:
    indexer = Indexer("arrival", 200.0)
    numbers: list[int] = []
    steady = [(0.05 * (i + 1), 10) for i in range(40)]
    for now, count in [*steady, (4.0, 400), *((now + 4.0, count) for now, count in steady)]:
        index, kept = indexer.take(SampleBlock(np.zeros((count, 1)), int(ns(np.array([now]))[0])))
        numbers += index[kept].tolist()
    assert numbers == list(range(1200))


def test_arrival_twice_the_nominal_rate_is_not_taken_for_the_nominal_one() -> None:
    taken = np.arange(12_000) / 400.0
    indexer, numbers = streamed(200.0, taken, np.random.default_rng(1))
    assert 5900 <= len(numbers) <= 6500
    assert not indexer.rejected["backwards"]
    assert 0 <= len(taken) - len(numbers) - indexer.rejected["duplicate"] < 30


def test_arrival_half_the_nominal_rate_leaves_gaps() -> None:
    _, numbers = polled(200.0, np.arange(1000) / 100.0)
    assert 1900 <= numbers[-1] <= 2010


def test_arrival_of_two_sources_of_a_rig_is_numbered_from_one_origin() -> None:
    first, second = Indexer("arrival", 100.0), Indexer("arrival", 100.0)
    second.origin = first.origin
    first.take(SampleBlock(np.zeros((10, 1)), 5_000_000_000))
    index, _ = second.take(SampleBlock(np.zeros((1, 1)), 5_500_000_000))
    assert index.tolist() == [59]
