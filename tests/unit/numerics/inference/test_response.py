"""Responses of the sampled model on a window's high bins, by modes and where there are not enough of them."""

import numpy as np
import pytest

from agent.numerics.inference.spectral.bins import Bins
from agent.numerics.inference.spectral.response import Response
from agent.numerics.model.uncertain import sampled
from tests.unit.numerics.inference.chain import ChainRig

WINDOW, KEPT = 200, 30
USUAL = ChainRig(masses=(2.0, 1.0), springs=(800.0, 600.0), dampers=(2.0, 1.5), period=0.005)
CRITICAL = ChainRig((1.0,), (100.0,), (20.0,), 0.005, seen=("displacement",))


@pytest.mark.parametrize(("rig", "is_modal"), [(USUAL, True), (CRITICAL, False)])
def test_outputs_above_the_kept_bins_are_those_of_the_resolvent(rig: ChainRig, is_modal: bool) -> None:
    """A critically damped mass has one direction for two poles."""
    at = sampled(rig.rig, rig.theta, np.zeros(rig.count))
    response = Response(at, Bins(WINDOW, KEPT))
    rng = np.random.default_rng(1)
    z = response.bins.z_high
    u = rng.standard_normal((len(z), at.B.shape[1])) + 1j * rng.standard_normal((len(z), at.B.shape[1]))
    start, forced = rng.standard_normal((2, at.n))
    ends = (start - np.linalg.matrix_power(at.A, WINDOW) @ start - forced) / np.sqrt(WINDOW)
    states = np.array([
        np.linalg.solve(one * np.eye(at.n) - at.A, at.B @ pushed + one * ends)
        for one, pushed in zip(z, u, strict=True)
    ])  # fmt: skip
    expected = states @ at.C.T + u @ at.D.T
    np.testing.assert_allclose(response.above(u, start, forced), expected, atol=1e-9 * np.abs(expected).max())
    assert (response._modal is not None) is is_modal


def test_powers_of_a_sample_are_those_of_its_matrix() -> None:
    at = sampled(USUAL.rig, USUAL.theta, np.zeros(2))
    response = Response(at, Bins(WINDOW, KEPT))
    for samples in (0, 1, 7, 7, WINDOW):
        expected = np.linalg.matrix_power(at.A, samples)
        np.testing.assert_array_equal(response.power(samples), expected)
