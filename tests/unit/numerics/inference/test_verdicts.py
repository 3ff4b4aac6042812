"""What is said of the constants, from what is known of them."""

import numpy as np
import pytest

from agent.numerics.inference.constants import Constants, hypotheses_of
from agent.numerics.inference.verdicts import beliefs
from agent.numerics.model.uncertain import Constant

CONSTANTS = (Constant("m1", "mass", 0, 0.02), Constant("m2", "mass", 1, 0.02), Constant("x1", "output", 0, 0.01))
KINDS = ("mass", "mass", "output")


def known(log_odds: float) -> Constants:
    """Evidence of so many nats for "m1" against every other hypothesis."""
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    gain = np.array([log_odds if h.name == "m1" else 0.0 for h in prior.hypotheses])
    weight = prior.weight * np.exp(gain)
    return Constants(prior.hypotheses, weight / weight.sum(), prior.mean, prior.covariance)


def said(log_odds: float, windows: int) -> float:
    return next(b.probability for b in beliefs(known(log_odds), KINDS, windows) if b.name == "m1")


def test_verdict_after_many_windows_is_the_posterior() -> None:
    assert said(7.0, 1_000_000) == pytest.approx(known(7.0).probability("m1"), abs=1e-4)


def test_verdict_of_a_first_window_needs_more_evidence_than_one_of_many() -> None:
    assert known(7.0).probability("m1") > 0.9
    assert said(7.0, 1) < 0.5 < said(7.0, 20)
    assert said(300.0, 1) > 0.75
    assert said(300.0, 3) > 0.99
    rising = [said(10.0, windows) for windows in (1, 2, 5, 10, 100)]
    assert np.all(np.diff(rising) > 0)


def test_verdict_names_size_and_kind() -> None:
    found = {b.label: b for b in beliefs(known(0.0), KINDS, 10)}
    assert found["x1 drifts"].drifts
    assert found["m1"].kind == "mass"
    assert found["m1"].size == pytest.approx(0.0)
    assert sum(b.probability for b in found.values()) < 0.5
