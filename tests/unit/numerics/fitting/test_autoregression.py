"""The autoregression of a residual."""

import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from agent.numerics.fitting.colour import autoregression


@pytest.mark.parametrize("pole", [0.0, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("count", [40, 300, 2000])
def test_autoregression_solves_the_yule_walker_equations(pole: float, count: int, rng: np.random.Generator) -> None:
    for _ in range(20):
        e = lfilter([1.0], [1.0, -pole], rng.normal(size=count))
        a, variance = autoregression(e)
        r = np.array([e[: count - lag] @ e[lag:] for lag in range(len(a) + 1)]) / count
        expected = solve_toeplitz(r[:-1], r[1:]) if len(a) else np.zeros(0)
        np.testing.assert_allclose(a, expected, atol=1e-9)
        assert variance == pytest.approx(float(r[0] - expected @ r[1:]), rel=1e-9)
