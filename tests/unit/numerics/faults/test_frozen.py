"""Channels that froze in windows that no parameters explain."""

import numpy as np
import pytest

from agent.numerics.faults.frozen import Frozen

FloatArray = np.ndarray
W = 50


def window(seed: int, **standing: float) -> FloatArray:
    """Return a window of x1, x2, force and the constant 1; some of them stand at a value."""
    v = np.random.default_rng(seed).standard_normal((W, 4))
    v[:, 3] = 1.0
    for name, at in standing.items():
        v[:, ("x1", "x2", "force").index(name)] = at
    return v


def note(watched: Frozen, *windows: FloatArray) -> None:
    watched.note(np.vstack(windows), W * np.arange(1, len(windows) + 1), W)


@pytest.fixture
def frozen() -> Frozen:
    watched = Frozen(2, 1)
    note(watched, window(0))
    return watched


def test_force_that_froze_is_found_with_where_it_stands(frozen: Frozen) -> None:
    found = frozen.find(window(1, force=3.5))
    assert found is not None
    assert (found.suspect.kind, found.suspect.channels, found.sizes) == ("stuck", (2,), (3.5,))
    assert found.suspect.at_fault == 2


def test_all_channels_that_froze_are_found(frozen: Frozen) -> None:
    found = frozen.find(window(1, x1=1e-3, x2=-2e-3, force=0.0))
    assert found is not None
    assert (found.suspect.channels, found.sizes) == ((0, 1, 2), (1e-3, -2e-3, 0.0))


def test_force_that_stood_there_in_health_is_not_found(frozen: Frozen) -> None:
    note(frozen, window(1, force=0.0), window(4), window(2, force=4.0))
    assert frozen.find(window(3, force=0.0)) is None
    assert frozen.find(window(3, force=3.0)) is None
    assert frozen.find(window(3, force=4.5)) is not None


def test_force_that_moved_and_came_back_did_not_stand(frozen: Frozen) -> None:
    there_and_back = window(1)
    there_and_back[[0, -1], 2] = 3.0
    note(frozen, there_and_back)
    assert frozen.find(window(2, force=3.0)) is not None


def test_force_that_moved_within_the_window_is_not_found(frozen: Frozen) -> None:
    v = window(1, force=3.5)
    v[0, 2] = 3.500001
    assert frozen.find(v) is None


def test_reading_that_was_filled_in_by_rounding_still_stands(frozen: Frozen) -> None:
    v = window(1, force=3.5)
    v[10, 2] *= 1.0 + 2e-16
    assert frozen.find(v) is not None


def test_input_never_seen_to_work_is_found_where_it_does_not_rest_at_zero() -> None:
    assert Frozen(2, 1).find(window(0, force=3.5)) is None
    found = Frozen(2, 1).find_unmoved(window(0, force=3.5))
    assert found is not None
    assert found.suspect.channels == (2,)
    assert Frozen(2, 1).find_unmoved(window(0, force=0.0)) is None
    assert Frozen(2, 1).find_unmoved(window(0)) is None


def test_input_seen_to_work_is_no_unmoved_one(frozen: Frozen) -> None:
    assert frozen.find_unmoved(window(0, force=3.5)) is None


def test_output_that_never_moved_is_found_where_others_do() -> None:
    found = Frozen(2, 1).find_unmoved(window(0, x1=0.0))
    assert found is not None
    assert (found.suspect.channels, found.sizes) == ((0,), (0.0,))
    assert Frozen(2, 1).find_unmoved(window(0, x1=0.0, x2=0.0)) is None


def test_forces_that_rest_while_something_moves_are_said_so(frozen: Frozen) -> None:
    found = Frozen(2, 1).resting(window(0, force=0.0))
    assert found is not None
    assert (found.suspect.kind, found.suspect.channels) == ("forces", (2,))
    assert Frozen(2, 1).resting(window(0)) is None
    assert Frozen(2, 1).resting(window(0, x1=1.0, x2=0.0, force=0.0)) is None
    assert frozen.resting(window(0, force=0.0)) is None
