"""Spikes told from motion, lost readings filled, and all of it however the stream is cut."""

from itertools import pairwise

import numpy as np
import pytest

from agent.numerics.preprocessing.cleaning import Clean, Cleaner
from agent.numerics.preprocessing.tuning import BLOCK
from tests.unit.numerics.rigs import FloatArray, noisy, record, sampled

SIGMA = 1e-6
INPUTS = np.array([False, False, True])
FIELDS = ("v", "missing", "spike", "suspect")


def clean(v: FloatArray, cuts: list[int] | None = None, step: float = 0.0) -> Clean:
    cleaner = Cleaner(INPUTS, np.full(3, step))
    edges = [0, *(cuts or []), len(v)]
    pieces = [cleaner.take(v[a:b].copy()) for a, b in pairwise(edges)]
    pieces.append(cleaner.take(v[:0], end=True))
    return Clean(*(np.concatenate([getattr(piece, name) for piece in pieces]) for name in FIELDS))


def spiked(seed: int, samples: int = 3000, spikes: int = 12) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """The rig's readings, the same with spikes of one to three samples in the displacements, and where."""
    rng = np.random.default_rng(seed)
    true = noisy(rng, samples, SIGMA).v
    v, where = true.copy(), np.zeros(true.shape, dtype=bool)
    for place in rng.choice(np.arange(2 * BLOCK, samples - 20, 25), spikes, replace=False).tolist():
        at = slice(place, place + int(rng.integers(1, 4)))
        channel = int(rng.integers(2))
        v[at, channel] += rng.choice([-1, 1]) * rng.uniform(2e-3, 2e-2)
        where[at, channel] = True
    return true, v, where


@pytest.mark.parametrize("seed", range(4))
def test_cleaner_finds_every_spike_and_nothing_else(seed: int) -> None:
    true, v, where = spiked(seed)
    found = clean(v)
    assert np.array_equal(found.spike, where)
    assert np.abs(found.v - true)[:, :2].max() < 2e-5


@pytest.mark.parametrize("seed", range(3))
def test_cleaner_gives_the_same_however_the_stream_is_cut(seed: int) -> None:
    rng = np.random.default_rng(seed + 100)
    _, v, _ = spiked(seed, samples=1500)
    lost = rng.random(len(v)) < 0.02
    v[lost] = np.nan
    v[0] = 0.0
    v[rng.random(v.shape) < 0.01] = np.nan
    v[0] = 0.0
    whole = clean(v)
    assert len(whole) == len(v)
    assert np.isfinite(whole.v).all()
    for cuts in (sorted(rng.integers(0, len(v), 30).tolist()), list(range(len(v)))):
        again = clean(v, cuts)
        for name in FIELDS:
            assert np.array_equal(getattr(whole, name), getattr(again, name)), name


def test_cleaner_gives_undisturbed_samples_at_once() -> None:
    v = noisy(np.random.default_rng(0), 2000, SIGMA).v
    cleaner = Cleaner(INPUTS, np.zeros(3))
    for start in range(0, 2000, 7):
        piece = v[start : start + 7]
        assert np.array_equal(cleaner.take(piece).v, piece)
        assert not cleaner.waiting()


def test_cleaner_takes_neither_a_random_force_nor_blows_nor_steps_for_spikes_of_the_motion() -> None:
    rng = np.random.default_rng(1)
    u = 0.1 * rng.standard_normal((6000, 1))
    for blow in range(500, 5900, 400):
        u[blow : blow + 3, 0] += [300.0, 1000.0, 300.0]
    v = record(sampled(), u).v
    v[:, :2] += SIGMA * rng.standard_normal((6000, 2))
    v[3000:, 0] += 0.05
    found = clean(v)
    assert not found.spike.any()
    assert not found.missing.any()
    # of a blow on the force only the motion can tell whether it was one
    assert found.suspect[:, 2].any()
    assert np.array_equal(found.v, v)


def test_cleaner_leaves_runs_longer_than_three_as_they_are() -> None:
    v = noisy(np.random.default_rng(2), 1000, SIGMA).v
    v[500:504, 0] += 0.02
    found = clean(v)
    assert not found.spike.any()


def test_cleaner_takes_flicker_of_the_wires_step_for_what_it_is() -> None:
    v = np.zeros((2000, 3))
    v[np.random.default_rng(3).random((2000, 3)) < 0.05] = 1e-3
    assert not clean(v, step=1e-3).missing.any()


@pytest.mark.parametrize("seed", range(3))
def test_cleaner_learns_the_step_of_a_channel_that_nobody_states(seed: int) -> None:
    """Text with three decimals that mostly rests on one number, and now and then flickers to the next."""
    rng = np.random.default_rng(seed)
    slow = 0.02 * np.sin(2 * np.pi * 0.05 * np.arange(20_000) * 1e-3)
    v = np.round(np.column_stack([slow, slow, slow]) + 2e-4 * rng.standard_normal((20_000, 3)), 3)
    found = clean(v)
    assert not found.spike.any()
    v[15_000, 1] += 0.05
    assert np.argwhere(clean(v).spike).tolist() == [[15_000, 1]]


def test_cleaner_without_any_reading_of_a_channel_at_the_end_repeats_the_last() -> None:
    v = noisy(np.random.default_rng(4), 300, SIGMA).v
    v[-3:, 1] = np.nan
    found = clean(v)
    assert found.missing[-3:, 1].all()
    assert np.all(found.v[-3:, 1] == v[-4, 1])


@pytest.mark.parametrize("size", [1e8, 1e12, 9e29])
@pytest.mark.parametrize("length", [1, 2, 3])
def test_cleaner_input_beyond_all_that_its_sensor_can_mean_is_a_spike_whatever_the_motion_says(
    size: float, length: int
) -> None:
    true, v, _ = spiked(3, spikes=0)
    v[1000 : 1000 + length, 2] = -size
    for cuts in ([], [900, 1000, 1001, 1003, 1010]):
        found = clean(v, cuts)
        assert np.flatnonzero(found.spike[:, 2]).tolist() == list(range(1000, 1000 + length))
        assert not found.suspect.any()
        assert np.abs(found.v[:, 2]).max() <= 2 * np.abs(true[:, 2]).max()


@pytest.mark.parametrize("cuts", [[], [900, 1500, 1999, 2000, 2001, 2003]])
def test_cleaner_force_that_comes_back_after_a_rest_is_no_spike(cuts: list[int]) -> None:
    """A float field has no step: at rest nothing is usual, but what it has read before it can mean."""
    _, v, _ = spiked(4, spikes=0)
    v[480:520, 2] = 1.0 + 1e-9 * np.arange(40)
    v[1000:2100, 2] = 0.0
    v[2000:2003, 2] = np.array([0.5, 1.0, 0.4]) * np.abs(v[:, 2]).max()
    assert not clean(v, cuts).spike[:, 2].any()


def test_cleaner_blow_on_a_force_that_rests_is_left_to_the_motion() -> None:
    _, v, _ = spiked(4, spikes=0)
    v[:, 2] = 0.0
    v[700:703, 2] = v[1400:1403, 2] = [2e3, 5e3, 1e3]
    assert not clean(v).spike[:, 2].any()


def test_force_that_is_held_is_searched_through_for_no_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    wild = Cleaner._is_wild
    monkeypatch.setattr(Cleaner, "_is_wild", lambda self, *place: asked.append(1) or wild(self, *place))
    force = np.repeat(np.random.default_rng(0).normal(0.0, 5.0, 60), 100)
    cleaner = Cleaner(np.array([True]), np.array([1e-3]))
    clean = cleaner.take(force[:, None])
    assert not clean.suspect.any()
    assert not asked


@pytest.mark.parametrize("cuts", [[], [900, 1500, 1999, 2000, 2001, 2003, 2010, 2020, 2021]])
def test_cleaner_random_force_after_a_rest_is_not_suspected_reading_by_reading(cuts: list[int]) -> None:
    """At rest nothing is usual; where everything then stands out, that is how the force is."""
    rng = np.random.default_rng(0)
    _, v, _ = spiked(4, spikes=0)
    v[1000:2000, 2] = 0.0
    v[2000:, 2] = 5.0 * rng.standard_normal(len(v) - 2000)
    v[2600, 2] += 200.0
    suspect = np.flatnonzero(clean(v, cuts).suspect[:, 2])
    assert suspect[-1] == 2600
    assert len(suspect) < 16  # 135 where each is held against the rest
