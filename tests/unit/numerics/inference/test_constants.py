"""The Gaussian sum over hypotheses on the constants against Bayes' rule on a linear problem, by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from agent.numerics.inference import tuning
from agent.numerics.inference.constants import Constants, Hypothesis, farthest, hypotheses_of
from agent.numerics.inference.information import Information
from agent.numerics.inference.mixture import NORMAL_975
from agent.numerics.inference.posterior import neglected
from agent.numerics.model.uncertain import Constant
from agent.types import FloatArray

CONSTANTS = (
    Constant("m1", "mass", 0, 0.02),
    Constant("m2", "mass", 1, 0.02),
    Constant("x1", "output", 0, 0.01),
)


def straight(S: np.ndarray, g: np.ndarray, at: np.ndarray) -> Information:
    """What a window says in which nothing is curved."""
    return Information(S, g, at, 0.0, np.zeros((0, len(g))), np.zeros(0))


def switched(known: Constants, said: Information) -> Constants:
    """What is known after a window right after the last."""
    return known.switched(known.switching(1.0, said))


NOTHING = straight(np.zeros((3, 3)), np.zeros(3), np.zeros(3))
"""A window that tells nothing of three constants."""


def problem() -> tuple[np.ndarray, np.ndarray, float]:
    rng = np.random.default_rng(3)
    X, sd = rng.standard_normal((40, 3)), 0.05
    return X, X @ np.array([0.08, -0.01, 0.0]) + sd * rng.standard_normal(40), sd


def members(hypothesis: Hypothesis) -> FloatArray:
    """(c,) 1 for each constant that is off."""
    return np.any([np.zeros(len(hypothesis.covariance)), *(off.members for off in hypothesis.off)], axis=0)


def test_constants_update_is_the_exact_mixture_posterior() -> None:
    X, y, sd = problem()
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    at = np.array([0.02, 0.0, -0.01])
    # information and score about another point than the mean
    after = prior.updated(straight(X.T @ X / sd**2, X.T @ (y - X @ at) / sd**2, at))
    evidence = []
    for i, h in enumerate(prior.hypotheses):
        P = h.covariance
        S = X @ P @ X.T + sd**2 * np.eye(len(y))
        evidence.append(np.log(prior.weight[i]) + multivariate_normal.logpdf(y, np.zeros(len(y)), S))
        gain = P @ X.T @ np.linalg.inv(S)
        assert after.mean[i] == pytest.approx(gain @ y, abs=1e-9)
        assert after.covariance[i] == pytest.approx(P - gain @ X @ P, abs=1e-11)
    wanted = np.exp(np.array(evidence) - max(evidence))
    assert after.weight == pytest.approx(wanted / wanted.sum(), abs=1e-9)
    assert after.probability("m1") > 0.5


def test_constants_moments_are_those_of_the_mixture() -> None:
    X, y, sd = problem()
    said = straight(X.T @ X / sd**2, X.T @ y / sd**2, np.zeros(3))
    after = Constants.prior(hypotheses_of(CONSTANTS)).updated(said)
    rng = np.random.default_rng(1)
    which = rng.choice(len(after.weight), 200_000, p=after.weight)
    draws = np.empty((len(which), 3))
    for i in np.unique(which):
        draws[which == i] = rng.multivariate_normal(
            after.mean[i], after.covariance[i], int((which == i).sum())
        )
    assert after.expected == pytest.approx(draws.mean(axis=0), abs=1e-4)
    assert np.sqrt(np.diag(after.total)) == pytest.approx(draws.std(axis=0), rel=0.02)


def test_constants_that_sharp_windows_ask_for_are_weighed_to_many_digits() -> None:
    """Two readings of sd 1e-6 of sums of three constants: by the normal density of those readings alone."""
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    X, sd = np.array([[1.0, -1.0, 1.0], [0.4, 0.1, -1.0]]), 1e-6
    read = X @ np.array([0.04, -0.03, 0.02])
    at = np.array([0.01, 0.01, 0.0])
    S = X.T @ X / sd**2
    after = prior.updated(straight(S, X.T @ (read - X @ at) / sd**2, at))
    log = [
        np.log(w) + multivariate_normal.logpdf(read, X @ m, X @ P @ X.T + sd**2 * np.eye(2))
        for w, m, P in zip(prior.weight, prior.mean, prior.covariance, strict=True)
    ]
    expected = np.exp(np.array(log) - max(log))
    np.testing.assert_allclose(after.weight, expected / expected.sum(), rtol=1e-4, atol=1e-12)
    np.testing.assert_allclose(after.mean @ X.T - read, 0.0, atol=1e-7 + 5 * sd)


def test_constants_switch_and_walk_from_window_to_window() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    sure = Constants(prior.hypotheses, np.eye(len(prior.weight))[0], prior.mean, prior.covariance)
    later = sure.predicted()
    assert later.weight.sum() == pytest.approx(1.0)
    assert 1 - later.weight[0] == pytest.approx(tuning.SWITCH * (1 - prior.weight[0]))
    drifting = next(i for i, h in enumerate(prior.hypotheses) if h.name == "x1 drifts")
    grown = later.covariance[drifting, 2, 2] - sure.covariance[drifting, 2, 2]
    assert grown == pytest.approx(tuning.DRIFT_WALKS[0] ** 2, rel=1e-3)


def test_constants_refuted_hypothesis_comes_back_with_its_prior() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    # m1 8 % off, others right
    told = prior.updated(straight(np.diag([1e8] * 3), np.array([8e6, 0.0, 0.0]), np.zeros(3)))
    later = switched(told, NOTHING)
    refuted = told.weight < 0.1 * tuning.SWITCH * prior.weight
    static = refuted & ~np.array([h.drifts for h in prior.hypotheses])
    assert static[0]
    stays = told.weight > 10 * tuning.SWITCH * prior.weight
    assert stays.any()
    assert np.all(later.mean[static] == 0.0)
    assert later.covariance[static] == pytest.approx(prior.covariance[static])
    assert np.array_equal(later.mean[stays], told.mean[stays])
    assert later.weight == pytest.approx(told.predicted().weight)


def test_constants_that_are_shut_do_not_begin_to_be_off_and_others_do() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    sure = Constants(prior.hypotheses, np.eye(len(prior.weight))[0], prior.mean, prior.covariance)
    said = straight(np.diag([1e8] * 3), np.array([8e6, 0.0, 0.0]), np.zeros(3))  # m1 is 8 % off
    off = np.array([h.name == "m1" for h in prior.hypotheses])
    every = sure.switched(sure.switching(1.0, said))
    shut = sure.switched(sure.switching(1.0, said, shut=np.array([0])))
    assert every.weight[off].sum() > 0.9
    assert shut.weight[[members(h)[0] > 0 for h in prior.hypotheses]].max() < 1e-200
    other = sure.switched(sure.switching(1.0, said, shut=np.array([1])))
    assert other.weight[off].sum() > 0.9


def test_gain_that_begins_to_drift_after_long_is_said_to_drift_at_once() -> None:
    """By two tenths of a percent a window, from 4 % off, where each window knows it to 0.02 %."""
    rng = np.random.default_rng(5)
    sd = np.full(3, 2e-4)
    known = Constants.prior(hypotheses_of(CONSTANTS))
    drifts = []
    for window in range(45):
        found = np.array([0.0, 0.0, 0.04 + 2e-3 * max(0, window - 39)]) + sd * rng.standard_normal(3)
        known = switched(known, straight(np.diag(sd**-2.0), found / sd**2, np.zeros(3)))
        drifts.append(known.drift_probability)
    assert max(drifts[:40]) < 0.05
    assert min(drifts[42:]) > 0.9
    assert known.probability("x1") > 0.99
    assert known.expected[2] == pytest.approx(0.05, abs=5e-4)


def test_gain_begins_to_drift_from_where_it_is_known_to_be() -> None:
    prior = Constants.prior(hypotheses_of(CONSTANTS))
    told = prior.updated(straight(np.diag([1e8] * 3), np.array([0.0, 0.0, 4e6]), np.zeros(3)))  # x1 4 % off
    none = replace(told, weight=np.where([h.drifts for h in told.hypotheses], 0, told.weight))
    later = switched(none, NOTHING)
    x1 = next(i for i, h in enumerate(prior.hypotheses) if h.name == "x1 drifts")
    mean, total = none.standing
    assert later.mean[x1] == pytest.approx([0.0, 0.0, mean[2]])
    assert later.covariance[x1, 2, 2] == pytest.approx(total[2, 2] + prior.covariance[0, 2, 2], rel=1e-6)
    assert later.covariance[x1, 0, 0] == pytest.approx(prior.covariance[0, 0, 0])


def test_gain_drifts_beside_one_mass_that_is_off_where_all_else_is_exact() -> None:
    """All else is so surely exact that no wider data sheets explain what is off."""
    known = Constants.prior(hypotheses_of(CONSTANTS))
    S = 1e8 * np.outer([1.0, 0.0, -1.0], [1.0, 0.0, -1.0]) + np.diag([0.0, 1e10, 0.0])
    for window in range(20):
        off = np.array([0.12, 0.0, -2.5e-3 * window])
        known = switched(known, straight(S, S @ off, np.zeros(3)))
    assert known.drift_probability > 0.99
    stands = known.weight >= tuning.STANDING_WEIGHT
    assert np.min(np.abs(known.mean[stands, 0] - 0.12) / np.sqrt(known.covariance[stands, 0, 0])) < 1.96


def test_what_is_off_and_drifts_is_one_thing() -> None:
    found = hypotheses_of(CONSTANTS)
    assert not [h.name for h in found if len({off.name for off in h.off}) < len(h.off)]
    # from its data sheet, and from wherever it is
    wide = [h.covariance[2, 2] > tuning.OFF_RELATIVE**2 for h in found if h.name == "x1 drifts"]
    assert any(wide)
    assert not all(wide)


def test_gain_that_drifts_beside_a_mass_that_is_off_says_nothing_of_the_mass() -> None:
    """One scale of three that no data tell apart: what drifts of it is seen, not whose the rest is."""
    known = Constants.prior(hypotheses_of((CONSTANTS[0], CONSTANTS[2])))
    S = 1e8 * np.outer([1.0, -1.0], [1.0, -1.0])
    for window in range(20):
        off = np.array([0.045, -2.5e-3 * window])
        known = switched(known, straight(S, S @ off, np.zeros(2)))
    assert known.drift_probability > 0.99
    stands = known.weight >= tuning.STANDING_WEIGHT
    sds = np.abs(known.mean[stands, 0] - 0.045) / np.sqrt(known.covariance[stands, 0, 0])
    assert sds.min() < 1.96


def test_constants_that_are_all_off_do_not_slide_to_the_narrowest_data_sheets() -> None:
    """Where no constant can be off alone, data sheets three times as wide explain it: window after window."""
    known = Constants.prior(hypotheses_of(CONSTANTS))
    apart = np.array([0.15, -0.15, 0.0])
    S = np.diag([1e8, 1e8, 0.0])  # nothing tells of x1
    sds = []
    for _ in range(40):
        known = switched(known, straight(S, S @ apart, np.zeros(3)))
        sds.append(np.sqrt(known.total[2, 2]))
    assert min(sds) > 0.9 * sds[0]


def test_constants_that_are_right_stay_as_well_known_as_they_are() -> None:
    """A wide hypothesis pays for its width each time that it is switched to, however long a rig runs."""
    known = Constants.prior(hypotheses_of(CONSTANTS))
    S = np.diag([1e6, 1e6, 0.0])  # nothing tells of x1, whose interval is that of the hypotheses that stand
    sds = []
    for _ in range(1000):
        known = switched(known, straight(S, np.zeros(3), np.zeros(3)))
        sds.append(np.sqrt(known.total[2, 2]))
    assert sds[-1] < 1.05 * sds[2]


def test_constants_some_windows_later_are_what_as_many_steps_make_them() -> None:
    known = Constants.prior(hypotheses_of(CONSTANTS))
    known = Constants(known.hypotheses, np.eye(len(known.weight))[0], known.mean, known.covariance)
    stepped = known
    for _ in range(7):
        stepped = stepped.predicted()
    at_once = known.predicted(7)
    assert at_once.weight == pytest.approx(stepped.weight, abs=1e-12)
    assert at_once.covariance == pytest.approx(stepped.covariance, rel=1e-12)
    assert known.drift_probability == 0
    drifts = np.array([h.drifts for h in stepped.hypotheses])
    assert 0 < stepped.drift_probability == pytest.approx(stepped.weight[drifts].sum())


def test_constants_that_are_exact_have_no_hypothesis() -> None:
    exact = (Constant("m1", "mass", 0, 0.0), *CONSTANTS[1:])
    assert "m1" not in {h.name for h in hypotheses_of(exact)}
    assert "m2" in {h.name for h in hypotheses_of(exact)}


def test_two_scales_are_off_at_once_as_likely_as_each_by_itself_where_neither_is_part_of_the_other() -> None:
    found = hypotheses_of(CONSTANTS)
    each = {h.name: h for h in found if len(h.off) == 1 and not h.drifts and h.level == "as configured"}
    two = [h for h in found if len(h.off) == 2 and not h.drifts]
    # all masses are off with a sensor, not with one of them
    assert {h.name for h in two} == {"m1 and m2", "m1 and x1", "m2 and x1", "x1 and all masses"}
    exact = found[0].covariance
    single = (1 - tuning.PRIOR_HEALTHY) / len(each)
    for h in two:
        one, other = (each[off.name].covariance for off in h.off)
        np.testing.assert_allclose(h.covariance, one + other - exact)
        assert h.prior == pytest.approx(single**2)


def test_a_force_is_held_or_runs_as_configured_however_well_all_else_is_known() -> None:
    late = tuple(Constant("delay", "delay", number, 0.25, apart=number == 1) for number in (0, 1))
    found = hypotheses_of((*CONSTANTS, *late))
    alone = [h for h in found if len(h.off) <= 1]
    held = [h for h in alone if members(h)[4]]
    healthy = [h for h in found if not h.off and h.covariance[3, 3] < 0.01**2]
    others = np.ix_(range(4), range(4))
    assert all(h.covariance[4, 4] < 0.01**2 for h in found if not members(h)[4])
    assert all(h.covariance[4, 4] >= tuning.OFF_DELAY**2 for h in held)
    for one, beside in zip(held, healthy, strict=True):
        assert one.covariance[others] == pytest.approx(beside.covariance[others])
        assert one.walk[others] == pytest.approx(beside.walk[others])
    of_delay = sum(h.prior for h in alone if members(h)[3])
    assert sum(h.prior for h in held) == pytest.approx(of_delay)
    # held, and something else is off: whatever may be off alone, but for when inputs act
    both = {h.name for h in found if len(h.off) > 1 and members(h)[4]}
    assert both == {f"{h.name} and delay" for h in alone if members(h)[:3].any()}
    assert not [h.name for h in found if members(h)[3] and len(h.off) > 1]
    assert sum(h.prior for h in found) == pytest.approx(1.0, abs=0.03)


def test_a_commanded_force_that_acts_late_stands_beside_everything_else() -> None:
    late = (Constant("delay", "delay", 0, 0.25, apart=True), Constant("delay", "delay", 1, 0.25))
    found = hypotheses_of((*CONSTANTS, *late))
    says = [{off.name for off in h.off} for h in found]
    off, others = (
        [h for h, s in zip(found, says, strict=True) if ("delay" in s) is it] for it in (True, False)
    )
    # open together in these, and in no other
    assert all(h.covariance[i, i] >= tuning.OFF_DELAY**2 for h in off for i in (3, 4))
    assert all((h.covariance[4, 4] < 0.01**2) == (h.covariance[3, 3] < 0.01**2) for h in others)
    alone = [h for h in off if len(h.off) == 1]
    assert len(alone) == 1 + len(tuning.SHEET_FACTORS)
    beside = {h.name for h in off if len(h.off) > 1}
    assert beside == {f"{h.name} and delay" for h in others if len(h.off) == 1}
    assert sum(h.prior for h in off if len(h.off) > 1) < sum(h.prior for h in alone)
    prior = Constants.prior(found)
    assert prior.probability("delay") == pytest.approx(
        sum(h.prior for h in off) / sum(h.prior for h in found)
    )


def test_constants_update_by_information_that_drowns_the_prior_leaves_no_negative_variance(
    rng: np.random.Generator,
) -> None:
    known = Constants.prior(hypotheses_of(CONSTANTS))
    direction = rng.standard_normal(3)
    for _ in range(5):
        said = straight(1e22 * np.outer(direction, direction), 1e12 * direction, np.zeros(3))
        known = known.predicted().updated(said)
        size = np.einsum("hii->h", known.covariance)
        assert (np.linalg.eigvalsh(known.covariance)[:, 0] > -1e-13 * size).all()
        assert np.isfinite(known.weight).all()


def test_gain_that_creeps_is_said_to_drift() -> None:
    """By a twentieth of a percent a window, less than a data sheet's sd in all: no window shows it alone."""
    rng = np.random.default_rng(3)
    sd = np.array([2e-3, 2e-3, 4e-4])
    known = Constants.prior(hypotheses_of(CONSTANTS))
    for window in range(20):
        known = known.predicted()
        found = np.array([0.0, 0.0, 5e-4 * window]) + sd * rng.standard_normal(3)
        known = known.updated(straight(np.diag(sd**-2.0), found / sd**2, np.zeros(3)))
    assert known.drift_probability > 0.9
    assert known.expected[2] == pytest.approx(5e-4 * window, abs=1e-3)


def test_inputs_that_act_in_time_do_not_say_that_masses_and_gains_are_exact() -> None:
    """Their delay is known to a hundredth of its data sheet; one scale that they share is 2.5 % off."""
    delay = Constant("delay", "delay", 0, 0.25)
    found = Constants.prior(hypotheses_of((CONSTANTS[0], CONSTANTS[2], delay)))
    S = 1e6 * np.outer([1.0, -1.0, 0.0], [1.0, -1.0, 0.0]) + np.diag([0.0, 0.0, 1e5])
    after = found
    for _ in range(40):
        after = switched(after, straight(S, S @ np.array([0.025, 0.0, 0.0]), np.zeros(3)))
    within = sum(w for w, h in zip(after.weight, after.hypotheses, strict=True) if not h.off)
    assert within > 0.7


def test_what_may_be_off_stands_beside_constants_that_are_within_their_data_sheets() -> None:
    """A mass 18 % off and its only sensor 1.5 %: their one scale is as far off as either alone explains."""
    found = Constants.prior(hypotheses_of((CONSTANTS[0], CONSTANTS[2])))
    S = 1e8 * np.outer([1.0, -1.0], [1.0, -1.0])
    after = found.updated(straight(S, S @ np.array([0.163, 0.015]), np.zeros(2)))
    off = np.array([h.name == "m1" for h in after.hypotheses]) & (after.weight >= tuning.STANDING_WEIGHT)
    sds = np.abs(after.mean[off, 1] - 0.015) / np.sqrt(after.covariance[off, 1, 1])
    assert sds.min() < 1.96


def test_what_all_masses_moved_by_and_delays_bend_nothing() -> None:
    late = (*CONSTANTS, Constant("x2", "output", 1, 0.01), Constant("delay", "delay", 0, 0.25))
    moved = np.array([[0.1, 0.1, -0.05, -0.05, 0.5], [0.1, 0.0, 0.0, 0.0, 0.5], [0.0, 0.0, 0.0, -0.2, 0.0]])
    assert farthest(late, moved) == pytest.approx([0.0, 0.05, 0.1])


def test_spring_of_two_masses_is_within_what_is_neglected_of_its_line() -> None:
    """k = ω² m1 m2 / (m1 + m2), the frequency known: k runs along a line in the logarithms of the masses."""
    eta = np.array([[0.25, -0.05], [-0.05, 0.25]])
    masses = 2.0 * np.exp(eta)
    exact = masses.prod(axis=1) / masses.sum(axis=1)
    along = np.exp(0.5 * eta.sum(axis=1))  # equal masses count for a half each
    of_two = (Constant("m1", "mass", 0, 0.02), Constant("m2", "mass", 1, 0.02))
    apart, size = (along - 1.0)[:, None], np.ones(1)
    misses = np.abs(exact - along)
    assert (misses < NORMAL_975 * neglected(apart, size, farthest(of_two, eta))[:, 0]).all()
    # by the square of what the spring itself moved an interval would hold neither
    assert (misses > NORMAL_975 * neglected(apart, size, np.zeros(2))[:, 0]).all()
