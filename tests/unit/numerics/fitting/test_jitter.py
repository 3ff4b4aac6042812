"""Noise that goes with the rate of what is read: found where it is there, and nothing where it is not."""

import numpy as np
import pytest

from agent.numerics.fitting.jitter import Jitter, find_jitter
from agent.types import FloatArray

PERIOD = 1e-3
SIGMA = np.array([5e-6, 8e-6])
LEARNT, STATED = np.zeros(2, dtype=bool), np.ones(2, dtype=bool)


def motion(samples: int) -> FloatArray:
    """Two displacements (N, 2) of some millimetres."""
    t = PERIOD * np.arange(samples)
    return np.column_stack([3e-3 * np.sin(9.0 * t) + 1e-3 * np.sin(31.0 * t), 4e-3 * np.cos(8.0 * t)])


def noise(rng: np.random.Generator, samples: int, jitter_s: float) -> FloatArray:
    """Noise (N, 2) of sensors and of instants that jitter, one for both channels."""
    rate = np.gradient(motion(samples), PERIOD, axis=0)
    return SIGMA * rng.standard_normal((samples, 2)) + jitter_s * rng.standard_normal((samples, 1)) * rate


def test_find_jitter_of_readings_whose_instants_jitter_is_its_size() -> None:
    rng = np.random.default_rng(1)
    e = noise(rng, 4000, 200e-6)
    found = find_jitter(e / SIGMA, motion(4000) + e, SIGMA, STATED, PERIOD, None)
    assert found is not None
    assert np.sqrt(found.delay2) == pytest.approx(200e-6, rel=0.1)
    assert found.delay2 == pytest.approx(200e-6**2, abs=4.0 / np.sqrt(found.precision))


def test_find_jitter_of_noise_without_any_is_nothing_in_a_hundred_windows() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        e = noise(rng, 1000, 0.0)
        assert find_jitter(e / SIGMA, motion(1000) + e, SIGMA, LEARNT, PERIOD, None) is None


def test_find_jitter_of_a_residual_that_remembers_itself_is_nothing() -> None:
    e = SIGMA * (1.0 + 50.0 * np.abs(motion(1000))) * np.sin(0.3 * np.arange(1000))[:, None]
    assert find_jitter(e / SIGMA, motion(1000) + e, SIGMA, LEARNT, PERIOD, None) is None


def test_find_jitter_in_further_windows_grows_precise() -> None:
    rng, found = np.random.default_rng(3), None
    for _ in range(10):
        e = noise(rng, 1000, 200e-6)
        found = find_jitter(e / SIGMA, motion(1000) + e, SIGMA, STATED, PERIOD, found)
    assert found is not None
    assert np.sqrt(found.delay2) == pytest.approx(200e-6, rel=0.05)


def test_jitter_ratio_is_one_for_what_the_speed_explains_and_counts_what_is_beyond() -> None:
    rng = np.random.default_rng(4)
    jitter = Jitter(200e-6**2, np.ones(2), SIGMA, PERIOD, 1e40)
    for speed in (0.0, 0.3, 1.0, 3.0):
        y = speed * motion(3000)
        rate2 = np.mean(np.gradient(y, PERIOD, axis=0)[1000:] ** 2, axis=0)
        s2 = float(np.mean(1.0 + 200e-6**2 * rate2 / SIGMA**2))
        late = 200e-6 * rng.standard_normal((3000, 1)) * np.gradient(y, PERIOD, axis=0)
        seen = y + late + SIGMA * rng.standard_normal((3000, 2))
        ratios = jitter.ratio(np.array([s2, 2.0 * s2]), seen, np.array([2999, 2999]), 2000)
        assert ratios == pytest.approx([1.0, 2.0], rel=0.08)
