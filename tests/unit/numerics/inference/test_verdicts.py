"""What is said of the constants, from what is known of them."""

import numpy as np
import pytest

from agent.numerics.inference.constants import Constants, hypotheses_of
from agent.numerics.inference.verdicts import beliefs
from agent.numerics.model.uncertain import Constant

CONSTANTS = (
    Constant("m1", "mass", 0, 0.02),
    Constant("m2", "mass", 1, 0.02),
    Constant("x1", "output", 0, 0.01),
)
KINDS = ("mass", "mass", "output")


def known(log_odds: float) -> Constants:
    """Evidence of so many nats for "m1" against every other hypothesis."""
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    gain = np.array([log_odds if h.name == "m1" else 0.0 for h in prior.hypotheses])
    weight = prior.weight * np.exp(gain)
    return Constants(prior.hypotheses, weight / weight.sum(), prior.mean, prior.covariance)


def test_verdict_names_what_is_off_and_how_surely() -> None:
    found = {b.label: b.probability for b in beliefs(known(7.0), KINDS)}
    assert found["m1"] == pytest.approx(known(7.0).probability("m1"))
    assert max(found, key=lambda label: found[label]) == "m1"


def test_verdict_names_size_and_kind() -> None:
    found = {b.label: b for b in beliefs(known(0.0), KINDS)}
    assert found["x1 drifts"].drifts
    assert found["m1"].kind == "mass"
    assert found["m1"].size == pytest.approx(0.0)
    assert sum(b.probability for b in found.values()) < 0.5


def test_two_things_that_are_off_are_two_beliefs() -> None:
    constants = (Constant("m1", "mass", 0, 0.02), Constant("delay", "delay", 0, 0.2, apart=True))
    prior = Constants.prior(hypotheses_of(constants))
    both = np.array([h.late is not None for h in prior.hypotheses], dtype=float)
    mean = both[:, None] * [np.log(1.05), 0.5]
    known = Constants(prior.hypotheses, both / both.sum(), mean, prior.covariance)
    found = {b.name: b for b in beliefs(known, ("mass", "delay"))}
    assert {name: b.probability for name, b in found.items()} == pytest.approx({"m1": 1.0, "delay": 1.0})
    assert {name: b.size for name, b in found.items()} == pytest.approx({"m1": 0.05, "delay": 0.5})


def test_ways_in_which_the_same_may_be_off_are_one_belief() -> None:
    late = tuple(Constant("delay", "delay", number, 0.2, apart=number == 1) for number in (0, 1))
    prior = Constants.prior(hypotheses_of(late))
    ways = [i for i, h in enumerate(prior.hypotheses) if h.name == "delay"]
    members = np.array([h.members for h in prior.hypotheses])
    mean = members * [0.3, 0.5]
    (found,) = beliefs(Constants(prior.hypotheses, prior.weight, mean, prior.covariance), ("delay", "delay"))
    assert found.probability == pytest.approx(prior.probability("delay"))
    assert found.size == pytest.approx(0.4)
    spread = prior.covariance[ways[0], 0, 0]
    assert found.sd == pytest.approx(np.hypot(np.sqrt(spread), 0.1))
