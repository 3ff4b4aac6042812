"""The bank as a stream: isolation of windows, portions, restarts, segments, memory."""

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.window.filtering.hops import HopPlan
from agent.numerics.window.filtering.noise import Coloured, NoiseModel
from agent.numerics.window.rows import BankRows, Windowed
from agent.numerics.window.stream import Stream
from tests.unit.numerics.window.bank_rigs import bank_rig, due, joined, rows_of

FloatArray = NDArray[np.float64]
RIG = bank_rig()
SIGMA = np.full(2, 1e-4)
NOISE = NoiseModel(SIGMA, np.full(2, 0.2), (Coloured("force", 0, 0.95, 0.3),))
TWO_COLOURS = NoiseModel(SIGMA, np.full(2, 0.2), (*NOISE.coloured, Coloured("sensor", 1, 0.9, 3e-4)))
PLAN = HopPlan(133, 20)


def first(rows: BankRows, length: int = 0) -> Windowed:
    windowed = rows.windows[length]
    assert windowed is not None
    return windowed


def record(samples: int, seed: int = 1) -> tuple[FloatArray, FloatArray]:
    return RIG.record(np.random.default_rng(seed), NOISE, samples, np.zeros(4))


@pytest.mark.parametrize("noise", [NOISE, NoiseModel(SIGMA, np.zeros(2))], ids=["forces", "sensors"])
def test_two_pasts_of_the_same_window_give_the_same_estimate(noise: NoiseModel) -> None:
    y, u = record(273)
    rng = np.random.default_rng(2)
    other_y, other_u = y.copy(), u.copy()
    other_y[:-133] = 0.05 * rng.standard_normal((140, 2))
    other_u[:-133] = 20 * rng.standard_normal((140, 2))
    one, other = (first(rows_of(RIG, noise, PLAN, (), r)).normal for r in ((y, u), (other_y, other_u)))
    prior = np.diag([0.0] * 4 + [1e4, 1e6, 1e4])
    covariance = np.linalg.inv(one.H[-1] + prior)
    changed = np.linalg.solve(other.H[-1] + prior, other.g[-1]) - covariance @ one.g[-1]
    assert np.max(np.abs(changed) / np.sqrt(np.diag(covariance))) < 1e-9


@pytest.mark.parametrize("noise", [NOISE, TWO_COLOURS], ids=["one colour", "two colours"])
@pytest.mark.parametrize("window", [133, 140, 613, 600])
def test_rows_are_the_same_to_the_last_bit_however_samples_arrive(window: int, noise: NoiseModel) -> None:
    y, u = record(1500)
    v = np.hstack([y, u])
    whole = rows_of(RIG, noise, HopPlan(window, 20), (12, 40), (y, u))
    for size in (13, 137):
        stream = Stream(RIG.model, RIG.push, noise, HopPlan(window, 20), (12, 40), RIG.interest)
        pieces = []
        for start in range(0, 1500, size):
            stream.append(start, v[start : start + size])
            pieces += due(stream)
        portions = joined(pieces)
        assert np.array_equal(portions.index, whole.index)
        for length in range(3):
            one, other = first(whole, length), first(portions, length)
            assert np.array_equal(one.index, other.index)
            assert np.array_equal(one.normal.H, other.normal.H)
            assert np.array_equal(one.normal.g, other.normal.g)
            assert np.array_equal(one.normal.rss, other.normal.rss)
        one, other = first(whole), first(portions)
        assert one.jumps is not None
        assert other.jumps is not None
        assert np.array_equal(one.jumps.index, other.jumps.index)
        assert np.array_equal(one.jumps.cross, other.jumps.cross)


def test_rows_fall_due_where_the_plan_says_and_windows_wait_until_they_are_whole() -> None:
    rows = rows_of(RIG, NOISE, PLAN, (8,), record(400))
    assert rows.index.tolist() == PLAN.rows_between(0, 400).tolist()
    assert first(rows).index[0] == 132
    assert first(rows, 1).index[0] == 172


def test_a_new_segment_begins_windows_afresh_at_the_hop_grid() -> None:
    v = np.hstack(record(400))
    stream = Stream(RIG.model, RIG.push, NOISE, PLAN, (), RIG.interest)
    stream.append(0, v[:200])
    list(due(stream))
    stream.start_segment(207)
    stream.append(207, v[207:])
    rows = joined(due(stream))
    assert rows.index[0] == 232
    assert first(rows).index[0] == 352


def test_samples_that_do_not_follow_are_refused() -> None:
    v = np.hstack(record(100))
    stream = Stream(RIG.model, RIG.push, NOISE, PLAN)
    stream.append(0, v)
    with pytest.raises(ValueError, match="sample 101 does not follow on 99"):
        stream.append(101, v)


def test_a_sensor_without_noise_is_refused() -> None:
    with pytest.raises(ValueError, match="must be positive"):
        Stream(RIG.model, RIG.push, NoiseModel(np.array([1e-4, 0.0]), np.zeros(2)), PLAN)
