"""Missing readings: interpolants, and how far a reading may lie from its own."""

import numpy as np
import pytest

from agent.numerics.preprocessing.bridge import bridge_over, filled, lagrange


def test_filled_goes_through_cubics_exactly_and_repeats_at_the_ends() -> None:
    t = np.arange(40.0)
    signal = 1.0 + 0.3 * t - 0.02 * t**2 + 1e-3 * t**3
    missing = np.zeros(40, dtype=bool)
    missing[[0, 7, 15, 16, 17, 39]] = True
    found = filled(np.where(missing, np.nan, signal), missing)
    assert np.allclose(found[1:-1], signal[1:-1], rtol=1e-12)
    assert (found[0], found[-1]) == (signal[1], signal[-2])


def test_lagrange_weights_of_one_missing_reading_are_the_cubic_ones() -> None:
    assert np.allclose(lagrange(np.array([0, 1, 3, 4]), 2), np.array([-1, 4, 4, -1]) / 6)


def test_prior_of_a_missing_force_is_the_error_of_interpolation_elsewhere() -> None:
    rng = np.random.default_rng(3)
    v = np.column_stack([rng.standard_normal((4000, 2)), 2.0 * rng.standard_normal(4000)])
    missing = np.zeros(v.shape, dtype=bool)
    missing[[500, 900], 2] = missing[2000, 0] = True
    bridge = bridge_over(v, missing, 2)
    assert bridge is not None
    # of white noise the cubic interpolant's error has variance 1 + 34/36
    assert bridge.sd[bridge.channel == 2] == pytest.approx(2.0 * np.sqrt(1 + 34 / 36), rel=0.05)
    assert np.isinf(bridge.sd[bridge.channel == 0]).all()
