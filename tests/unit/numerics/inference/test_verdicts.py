"""What is said of the constants, from what is known of them."""

from dataclasses import replace

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


def known(log_odds: float) -> Constants:
    """Evidence of so many nats for "m1" against every other hypothesis."""
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    gain = np.array([log_odds if h.name == "m1" else 0.0 for h in prior.hypotheses])
    weight = prior.weight * np.exp(gain)
    return Constants(prior.hypotheses, weight / weight.sum(), prior.mean, prior.covariance)


def test_verdict_names_what_is_off_and_how_surely() -> None:
    found = {b.label: b.probability for b in beliefs(known(7.0), CONSTANTS)}
    assert found["m1"] == pytest.approx(known(7.0).probability("m1"))
    assert max(found, key=lambda label: found[label]) == "m1"


def test_verdict_names_size_and_kind() -> None:
    found = {b.label: b for b in beliefs(known(0.0), CONSTANTS)}
    assert found["x1 drifts"].drifts
    assert found["m1"].kind == "mass"
    assert found["m1"].size == pytest.approx(0.0)
    assert sum(b.probability for b in found.values()) < 0.5


def test_a_group_is_off_by_the_mean_of_its_members() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    together = np.array([h.name == "all masses" for h in prior.hypotheses], dtype=float)
    mean = np.broadcast_to([0.04, 0.06, 0.0], prior.mean.shape)
    sharp = np.broadcast_to(np.diag([3e-3, 4e-3, 1e-3]) ** 2, prior.covariance.shape)
    of_all = Constants(prior.hypotheses, together / together.sum(), mean, sharp)
    found = {b.name: b for b in beliefs(of_all, CONSTANTS)}["all masses"]
    assert found.size == pytest.approx(np.expm1(0.05))
    assert found.sd == pytest.approx(np.exp(0.05) * 2.5e-3)


def test_two_things_that_are_off_are_two_beliefs() -> None:
    constants = (Constant("m1", "mass", 0, 0.02), Constant("delay", "delay", 0, 0.2, apart=True))
    prior = Constants.prior(hypotheses_of(constants))
    both = np.array([len(h.off) == 2 for h in prior.hypotheses], dtype=float)
    mean = both[:, None] * [np.log(1.05), 0.5]
    known = Constants(prior.hypotheses, both / both.sum(), mean, prior.covariance)
    found = {b.name: b for b in beliefs(known, constants)}
    assert {name: b.probability for name, b in found.items()} == pytest.approx({"m1": 1.0, "delay": 1.0})
    assert {name: b.size for name, b in found.items()} == pytest.approx({"m1": 0.05, "delay": 0.5})


def test_ways_in_which_the_same_may_be_off_are_one_belief() -> None:
    late = tuple(Constant("delay", "delay", number, 0.2, apart=number == 1) for number in (0, 1))
    prior = Constants.prior(hypotheses_of(late))
    ways = [i for i, h in enumerate(prior.hypotheses) if h.name == "delay"]
    members = np.array([h.off[0].members if h.off else np.zeros(2) for h in prior.hypotheses])
    mean = members * [0.3, 0.5]
    (found,) = beliefs(Constants(prior.hypotheses, prior.weight, mean, prior.covariance), late)
    assert found.probability == pytest.approx(prior.probability("delay"))
    assert found.size == pytest.approx(0.4)
    spread = prior.covariance[ways[0], 0, 0]
    assert found.sd == pytest.approx(np.hypot(np.sqrt(spread), 0.1))


def test_a_drift_within_a_tenth_of_its_data_sheet_is_not_named() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    weight = np.array([h.drifts for h in prior.hypotheses], dtype=float)
    sharp = np.broadcast_to(np.eye(3) * 1e-5**2, prior.covariance.shape)
    for size, named in ((0.0005, False), (0.002, True), (-0.002, True)):
        mean = np.broadcast_to([0.0, 0.0, size], prior.mean.shape)
        found = beliefs(Constants(prior.hypotheses, weight / weight.sum(), mean, sharp), CONSTANTS)
        (drift,) = [b for b in found if b.drifts]
        assert (drift.probability > 0.99) is named


@pytest.mark.parametrize(("odds", "tied"), [(1.1, True), (3.9, True), (4.2, False), (20.0, False)])
def test_explanations_that_data_hardly_tell_apart_share_their_probability(odds: float, tied: bool) -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    names = [h.name if not h.drifts else "" for h in prior.hypotheses]
    weight = np.zeros(len(names))
    weight[[names.index("m1"), names.index("x1")]] = odds / (1 + odds), 1 / (1 + odds)
    found = {b.label: b.probability for b in beliefs(replace(prior, weight=weight), CONSTANTS)}
    assert (found["m1"] == pytest.approx(found["x1"])) is tied
    assert found["m1"] + found["x1"] == pytest.approx(1.0)


def test_two_that_are_off_at_once_count_once_where_explanations_tie() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    share = {"m1": 0.4, "x1": 0.4, "m1 and x1": 0.1}
    level = [h.level == "as configured" and not h.drifts for h in prior.hypotheses]
    weight = np.array([
        share.get(h.name, 0.0) if exact else 0.0 for h, exact in zip(prior.hypotheses, level, strict=True)
    ])  # fmt: skip
    weight[0] = 0.1  # nothing is off
    found = {b.label: b.probability for b in beliefs(replace(prior, weight=weight), CONSTANTS)}
    # either is off with 0.5 by itself; that one of them is, with 0.9
    assert found["m1"] == pytest.approx(0.45)
    assert found["x1"] == pytest.approx(0.45)
