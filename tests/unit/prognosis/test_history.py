"""Histories thinned without losing what matters, and steps."""

import numpy as np
import pytest
from scipy.optimize import isotonic_regression

from agent.prognosis.history import History, blocks, monotone, smoothed, sound
from agent.prognosis.steps import Step, events, find_steps, without
from tests.unit.prognosis.histories import bent


def test_sound_takes_outliers_out_and_leaves_drift_and_steps(rng: np.random.Generator) -> None:
    t = np.arange(100.0)
    value = 25.0 - 0.1 * t + 0.01 * rng.standard_normal(100)
    value[60:] -= 3.0
    spoilt = value.copy()
    spoilt[[20, 45]] += 8.0
    kept = sound(History(t, spoilt, np.full(100, 0.01)))
    assert set(t) - set(kept.t) == {20.0, 45.0}


def test_blocks_of_white_noise_have_the_mean_and_its_sd(rng: np.random.Generator) -> None:
    whole = History(np.arange(1000.0), rng.standard_normal(1000), np.ones(1000))
    thin = blocks(whole, 10)
    assert len(thin) == 10
    assert thin.sd == pytest.approx(np.full(10, 0.1))
    assert thin.value.mean() == pytest.approx(whole.value.mean())


def test_smoothed_of_a_noisy_fall_is_nearer_the_truth(rng: np.random.Generator) -> None:
    history = bent(rng, noise=0.3)
    truth = bent(np.random.default_rng(0), noise=0.0).value
    assert np.std(smoothed(history) - truth) < 0.5 * np.std(history.value - truth)


def test_step_is_found_with_its_date_and_size(rng: np.random.Generator) -> None:
    t = np.arange(120.0)
    value = 25.0 + 0.05 * rng.standard_normal(120)
    value[70:] -= 1.0
    history = History(t, value, np.full(120, 0.05))
    (step,) = find_steps(history)
    assert step.t == pytest.approx(70.0, abs=1.0)
    assert step.size == pytest.approx(-1.0, abs=0.15)
    assert np.ptp(without(history, [step]).value) < 0.6


@pytest.mark.parametrize("kind", ["walk", "fall", "white"])
def test_no_steps_are_found_where_there_are_none(rng: np.random.Generator, kind: str) -> None:
    made = {
        "walk": lambda: np.cumsum(rng.standard_normal(200)),
        "fall": lambda: bent(rng, 200).value,
        "white": lambda: rng.standard_normal(200),
    }
    found = [find_steps(History(np.arange(200.0), made[kind](), np.full(200, 0.05))) for _ in range(50)]
    assert sum(map(bool, found)) <= 3


def test_monotone_fit_is_that_of_scipy(rng: np.random.Generator) -> None:
    for n in (1, 2, 17, 160):
        value, weight = np.round(rng.standard_normal(n), 1), rng.uniform(0.1, 3.0, n)
        oracle = isotonic_regression(value, weights=weight).x
        assert monotone(value, weight) == pytest.approx(oracle, abs=1e-12)


def test_steps_of_one_direction_again_and_again_are_how_a_part_wears() -> None:
    down = [Step(float(day), -1.0, 0.1) for day in (10, 40, 70)]
    assert events(down) == []
    assert events(down[:2]) == down[:2]
    repaired = [*down, Step(80.0, 3.0, 0.1)]
    assert events(repaired) == repaired
