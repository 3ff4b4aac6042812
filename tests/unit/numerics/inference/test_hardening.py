"""Evidence of a change beside which springs that harden are weighed."""

from dataclasses import replace

import numpy as np

from agent.numerics.inference.hardening import changing
from tests.unit.numerics.inference.test_continuation import LEARNER, SIGMA, window_with


def test_jumps_that_are_nothing_but_rounding_are_no_evidence() -> None:
    """What the base leaves of them is a difference of large numbers, here just below 0."""
    window = window_with(np.zeros(8), 1.0)
    known = LEARNER.lineariser.prepared(window, LEARNER.prior(SIGMA, np.full(3, 0.3)))
    at = LEARNER.lineariser.point(window, known, known.theta, LEARNER.cuts)
    base = at.regression.layout.base
    V, fit = at.fitted
    G = at.G.copy()
    cross = G[:base, base:-1]
    G[base:-1, base:-1] = (1 - 1e-10) * cross.T @ V @ cross
    G[base:-1, -1] = G[-1, base:-1] = cross.T @ fit
    with np.errstate(invalid="raise"):
        found = changing(replace(at, G=G), 1.0)
    assert abs(found) < 10.0
