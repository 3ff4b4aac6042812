"""With which windows a segment begins."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.estimator.explainer import Explainer
from agent.numerics.estimator.sliding import SlidingEstimator
from tests.unit.numerics.estimator.test_sliding import settings
from tests.unit.numerics.rigs import noisy

WINDOW, SIGMA = 1000, 1e-6


@pytest.mark.parametrize(
    ("share", "rests", "begins"), [(0.3, 600, False), (1.0, 600, True), (0.3, 0, True)],
    ids=["gone at rest", "as configured at rest", "gone in motion"],
)  # fmt: skip
def test_beginning_with_a_window_that_rests_for_half_is_refused_where_springs_are_gone(
    share: float, rests: int, begins: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    samples = noisy(np.random.default_rng(3), WINDOW, SIGMA)
    whole = SlidingEstimator(settings(WINDOW, 50, SIGMA))
    whole.step(0, samples.y, samples.u)
    posterior, known = whole.explainer.posterior, whole.explainer.known
    assert posterior is not None
    said = replace(posterior, theta=share * posterior.theta)
    monkeypatch.setattr(Explainer, "_first", lambda *_: (said, known))
    y = samples.y.copy()
    y[:rests] = y[rests]
    ml = SlidingEstimator(settings(WINDOW, 50, SIGMA))
    ml.step(0, y, samples.u)
    assert ml.explainer.bank.is_running is begins
