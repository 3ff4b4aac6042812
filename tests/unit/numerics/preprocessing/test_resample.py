"""Readings between samples."""

import numpy as np
import pytest

from agent.numerics.preprocessing.resample import interpolated, split


def test_interpolation_is_exact_for_cubics_and_for_readings_themselves() -> None:
    index = np.arange(20, dtype=np.int64)
    values = 0.3 * index**3 - 2.0 * index**2 + index - 7.0
    place = np.array([3.0, 5.25, 9.5, 16.999])
    found = interpolated(index, values, *split(place))
    np.testing.assert_allclose(found, 0.3 * place**3 - 2.0 * place**2 + place - 7.0, rtol=1e-12)
    assert found[0] == values[3]


def test_interpolation_near_a_reading_is_that_reading() -> None:
    whole, part = split(np.array([4.0 - 1e-9, 4.0 + 1e-9, 4.5]))
    assert whole.tolist() == [4, 4, 4]
    assert part.tolist() == pytest.approx([0.0, 0.0, 0.5])


@pytest.mark.parametrize("place", [-0.5, 0.5, 17.5, 18.5, 19.5, 30.0])
def test_interpolation_outside_is_missing(place: float) -> None:
    index = np.arange(20, dtype=np.int64)
    inside = 1 <= place <= 17.5
    assert np.isfinite(interpolated(index, index * 1.0, *split(np.array([place])))).all() == inside


def test_interpolation_across_a_gap_or_a_missing_reading_is_missing() -> None:
    index = np.array([0, 1, 2, 3, 6, 7, 8, 9, 10, 11], dtype=np.int64)
    values = index * 1.0
    values[8] = np.nan
    place = np.array([1.5, 2.5, 3.0, 6.5, 7.5, 8.5, 5.0])
    found = interpolated(index, values, *split(place))
    np.testing.assert_allclose(found, [1.5, np.nan, 3.0, np.nan, 7.5, np.nan, np.nan])
