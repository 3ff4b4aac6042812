"""A rig is the same in other units of mass, time and length: from a wafer's cantilever to a ship's deck."""

from dataclasses import replace

import numpy as np
import pytest

from agent.types import EstimateBatch, FloatArray, IntArray
from tests.statistical.chains import TWO, Chain
from tests.statistical.nearly_right import Case, Play, records

WINDOWS = 6


def in_units(chain: Chain, mass: float, time: float, length: float) -> Chain:
    """The same motion where a kilogram is called `mass`, a second `time` and a metre `length` of them."""
    return replace(
        chain, masses=tuple(mass * m for m in chain.masses),
        springs=tuple(mass / time**2 * k for k in chain.springs),
        dampers=tuple(mass / time * b for b in chain.dampers),
        rate_hz=chain.rate_hz / time, window_s=chain.window_s * time, force_hz=chain.force_hz / time,
        noise=tuple(length * sd for sd in chain.noise), force_n=mass * length / time**2 * chain.force_n,
    )  # fmt: skip


def rows_of(chain: Chain) -> tuple[IntArray, FloatArray, FloatArray]:
    """Statuses (N, q) of one recording's rows, values and sds as shares of the true parameters."""
    rng = np.random.default_rng(8)
    made = Play.of(chain, rng, WINDOWS * chain.window + 1)
    batches = [r for r in records(Case(chain), made.readings()[:-1]) if isinstance(r, EstimateBatch)]
    status, value, sd = (np.concatenate([getattr(b, n) for b in batches]) for n in ("status", "value", "sd"))
    return status, value / chain.theta, sd / chain.theta


@pytest.mark.parametrize(
    ("mass", "time", "length"),
    [(1e-10, 1e-2, 1e-6), (1e-3, 1e-4, 1e-3), (1e-15, 1e-6, 1e-9), (1e6, 30.0, 10.0)],
    ids=["10 kHz", "1 MHz", "a cantilever of a wafer", "a deck"],
)
def test_rows_of_a_rig_are_the_same_in_any_units(mass: float, time: float, length: float) -> None:
    """Modes of 300 Hz and more are fast beside a second: no threshold may be one in SI."""
    status, value, sd = rows_of(TWO)
    there, seen, spread = rows_of(in_units(TWO, mass, time, length))
    np.testing.assert_array_equal(there, status)
    whole = np.isfinite(sd).all(axis=1)
    assert whole.any()
    np.testing.assert_allclose((seen - value)[whole] / sd[whole], 0.0, atol=1e-2)
    np.testing.assert_allclose(spread[whole] / sd[whole], 1.0, rtol=1e-2)
