"""A jump of which only rounding is left is no evidence."""

import numpy as np
import pytest

from agent.numerics.window.jump import Jumps


def test_jumps_of_readings_near_the_largest_number_are_finite_and_what_only_rounding_shows_is_zero() -> None:
    own = np.zeros((1, 1, 2, 2))
    own[0, 0] = np.diag([1e62, 4.0])
    cross = np.zeros((1, 1, 3, 2))
    cross[0, 0] = [[1e60, 6.0], [1e62, 0.0], [0.0, 0.0]]
    # the first jump is the first parameter: nothing is left of it but -1e47
    covariance = np.diag([(1 + 1e-15) * 1e-62, 0.0])[None]
    jumps = Jumps(np.zeros(1, dtype=np.int64), cross, own, (5,))
    assert jumps.glr(np.zeros((1, 2)), covariance)[0, 0] == pytest.approx(9.0)
