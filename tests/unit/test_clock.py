"""Labels of live samples: exact at first, never back, drawn to the wall clock, anew after a step."""

import numpy as np
import pytest

from agent.clock import SampleLabels, boot_id, monotonic_ns, wall_ns
from agent.tuning import DEAD_ZONE_NS

WALL = 1_760_000_000_000_000_000
SECOND = 1_000_000_000


def play(
    labels: SampleLabels, seconds: float, drift: float = 0.0, start: int = 0, rate: float = 1000.0
) -> np.ndarray:  # type: ignore[type-arg]
    """Blocks of 50 samples from a device whose clock runs 1 + drift as fast; arrivals late by up to 5 ms."""
    rng, pieces = np.random.default_rng(0), []
    for first in range(start, start + round(seconds * rate), 50):
        index = np.arange(first, first + 50, dtype=np.int64)
        true = (index[-1]) / rate / (1 + drift) * SECOND
        pieces.append(labels.label(index, round(true + rng.uniform(0, 5e6)), WALL))
    return np.concatenate(pieces)


@pytest.mark.parametrize("rate", [1000.0, 3000.0, 44_100.0])
def test_labels_first_block_is_anchor_plus_index_over_rate_exactly(rate: float) -> None:
    labels = SampleLabels(rate)
    index = np.arange(1_000_000, dtype=np.int64)
    stamps = labels.label(index, 0, WALL)
    exact = np.array([round(int(i) * 10**9 / rate) for i in index - index[-1]])
    np.testing.assert_array_equal(stamps - WALL, exact)


def test_labels_device_that_keeps_time_is_left_alone() -> None:
    labels = SampleLabels(1000.0)
    stamps = play(labels, 60.0)
    np.testing.assert_array_equal(np.diff(stamps), 1_000_000)
    assert labels.steps == []


@pytest.mark.parametrize("drift", [3e-4, -3e-4])
def test_labels_drifting_device_is_followed_and_never_goes_back(drift: float) -> None:
    stamps = play(SampleLabels(1000.0), 900.0, drift)
    assert np.diff(stamps).min() > 0
    true = WALL + (np.arange(len(stamps)) / 1000.0 / (1 + drift) * SECOND)
    behind = np.abs(stamps - true)
    # 0.3 ms a second would be 270 ms by the end
    assert behind[len(stamps) // 2 :].max() < 2 * DEAD_ZONE_NS


def test_labels_wall_step_is_a_new_anchor_and_noted() -> None:
    labels = SampleLabels(1000.0)
    first = labels.label(np.arange(100, dtype=np.int64), 0, WALL)
    second = labels.label(np.arange(100, 200, dtype=np.int64), SECOND // 10, WALL + 3600 * SECOND)
    assert second[-1] == WALL + SECOND // 10 + 3600 * SECOND
    assert labels.steps == [(int(first[-1]) + 1_000_000, 3600 * SECOND)]
    third = labels.label(np.arange(200, 300, dtype=np.int64), 2 * SECOND // 10, WALL + 3600 * SECOND)
    np.testing.assert_array_equal(np.diff(np.concatenate([second, third])), 1_000_000)
    assert len(labels.steps) == 1


def test_labels_small_wall_step_is_no_new_anchor() -> None:
    labels = SampleLabels(1000.0)
    first = labels.label(np.arange(100, dtype=np.int64), 0, WALL)
    second = labels.label(np.arange(100, 200, dtype=np.int64), SECOND // 10, WALL - SECOND // 2)
    assert second[0] - first[-1] == 1_000_000
    assert labels.steps == []


def test_clocks_are_integers_of_nanoseconds() -> None:
    before = monotonic_ns()
    assert isinstance(wall_ns(), int)
    assert monotonic_ns() >= before
    identifier = boot_id()
    assert identifier is None or len(identifier) == 36
