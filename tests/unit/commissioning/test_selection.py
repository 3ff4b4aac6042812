"""Choosing elements from what windows say: false additions where windows differ more than they should, ties,
signs."""

import numpy as np

from agent.commissioning.numerics.motion.pooled import Costs
from agent.commissioning.numerics.motion.selection import Selector
from agent.commissioning.tuning import TIE
from agent.types import FloatArray

WINDOWS, PARAMETERS = 12, 8


def costs(truth: FloatArray, rng: np.random.Generator, inflated: float, sd: float = 1.0) -> Costs:
    """Windows of a linear model about 0 whose estimates scatter `inflated` times more, as a variance, than
    they say."""
    q = len(truth)
    found = Costs.none(np.zeros(q), np.diag([2500.0]), np.zeros(1))
    found.prior = np.pad(found.prior, ((q, 0), (q, 0)))
    found.offset = np.zeros(q + 1)
    for _ in range(WINDOWS):
        root = rng.normal(size=(3 * q, q + 1)) / np.sqrt(3 * q) / sd
        # a constant that the data sheet knows to 2 % hides behind the parameters
        readings = root[:, :q] @ truth + np.sqrt(inflated) * rng.normal(size=3 * q) / np.sqrt(WINDOWS)
        found.add(root.T @ root * WINDOWS, root.T @ readings * WINDOWS, np.ones(q))
    return found


def selected(truth: FloatArray, rng: np.random.Generator, inflated: float) -> Selector:
    return Selector(costs(truth, rng, inflated), np.ones(len(truth), dtype=bool), inflated)


def test_selector_counts_dependent_data_once() -> None:
    """Windows that scatter four times more than they say: hardly an element is taken that is not there."""
    rng = np.random.default_rng(1)
    truth = np.concatenate([np.full(4, 60.0), np.zeros(PARAMETERS - 4)])
    kept = np.array([selected(truth, rng, 4.0).best().kept for _ in range(60)])
    assert kept[:, :4].all()
    false = kept[:, 4:].any(axis=1)
    assert false.mean() <= 0.05
    # what counts every sample once more would have taken: estimates beyond the same quantile by their own
    # word
    naive = 0
    for _ in range(60):
        selector = selected(truth, rng, 4.0)
        own = np.array(selector._H).sum(axis=0)[:PARAMETERS, :PARAMETERS]
        full = selector.choice(np.ones(PARAMETERS, dtype=bool))
        naive += bool(np.any((full.theta / np.sqrt(np.diag(np.linalg.inv(own))))[4:] > selector.needed))
    assert naive / 60 > 0.1


def test_selector_never_takes_what_would_be_negative() -> None:
    truth = np.array([60.0, -60.0, 60.0])
    assert selected(truth, np.random.default_rng(2), 1.0).best().kept.tolist() == [True, False, True]


def test_selector_shows_what_is_nearly_as_good_as_a_tie() -> None:
    rng = np.random.default_rng(3)
    near = []
    for _ in range(40):
        selector = selected(np.array([60.0, 60.0, 0.4, 0.0]), rng, 1.0)
        best = selector.best()
        gaps = [best.score - other.score for other in selector.neighbours(best)]
        near.append(min(gaps) < TIE)
        assert max(gaps) > 100
    assert 0.1 < np.mean(near) < 0.9


def test_selector_leaves_what_must_stay() -> None:
    rng = np.random.default_rng(4)
    selector = Selector(costs(np.array([60.0, 0.0]), rng, 1.0), np.array([True, False]), 1.0)
    assert selector.best().kept.tolist() == [True, True]


def test_selector_knows_little_of_what_a_constant_could_stand_for_in_whatever_units() -> None:
    """An element that a constant's prior alone tells from nothing is uncertain, its unit ever so small."""
    rng, unit = np.random.default_rng(5), np.array([1.0, 1e-7])
    found = Costs.none(np.zeros(2), np.diag([0.0, 0.0, 1.0]), np.zeros(3))
    for _ in range(WINDOWS):
        root = 1e3 * rng.normal(size=(6, 2))
        # the second element and the constant move the readings alike
        columns = np.column_stack([root[:, 0], root[:, 1], root[:, 1]]) * np.array([1.0, 1e-7, 1.0])
        readings = columns @ np.array([60.0, 0.0, 1.0]) + rng.normal(size=6)
        found.add(columns.T @ columns, columns.T @ readings, unit)
    selector = Selector(found, np.array([True, True]), 1.0)
    assert selector.best().kept.tolist() == [True, False]
    assert abs(selector.choice(np.array([True, True])).z[1]) < 3
