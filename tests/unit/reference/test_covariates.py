"""Lags, the regression on covariates and the moved reference, beside plain sums and known truths."""

from functools import partial

import numpy as np
import pytest

from agent.reference.covariates.dependence import Dependence, remark, shift, stepped, widened
from agent.reference.covariates.lags import Lag, LagFilter, Lagged, newest_period, series
from agent.reference.covariates.regression import alike, lags, regress
from agent.types import FloatArray

LAGS = (Lag(), Lag("delay", 600.0), Lag("first-order", 1800.0))
TEMPERATURE = Dependence(
    "temperature", "degC", -0.075, 0.001, -0.077, -0.073, "first-order", 7200.0, 6000.0, 8000.0, 20.0, 5.0,
    35.0, 6.0,
    1800.0, used=True,
)  # fmt: skip


@pytest.mark.parametrize("lag", LAGS)
def test_follower_feels_period_by_period_what_the_series_feels_at_once(lag: Lag) -> None:
    number = np.arange(500, 900)
    value = np.random.default_rng(1).normal(20.0, 5.0, 400)
    grid = series(number, value, 18.0, 3)
    lag_filter = LagFilter(dict(zip(number.tolist(), value.tolist(), strict=True)), 18.0, 3, lag)
    one_by_one = [lag_filter.at(period) for period in range(500, 900)]
    assert [one.known for one in one_by_one] == pytest.approx(grid.known(lag).tolist())
    beyond = slice(400 - 100, 400)  # by then it is the same what was before the first reading
    lagged = [one.deviation for one in one_by_one][beyond]
    assert lagged == pytest.approx(
        grid.lagged(lag)[beyond].tolist(), abs=0.2 if lag.shape == "first-order" else 1e-9
    )


def test_first_order_lag_is_the_sum_of_what_decays() -> None:
    lag = Lag("first-order", 600.0)
    x = np.random.default_rng(2).standard_normal(60)
    plain = [
        sum((1 - lag.kept) * lag.kept ** (p - j) * x[j] for j in range(p + 1)) + lag.kept ** (p + 1) * x[0]
        for p in range(60)
    ]
    assert series(np.arange(60), x, 0.0, 0).lagged(lag) == pytest.approx(plain)


def test_follower_holds_a_gap_then_guesses_and_says_how_little_it_knows() -> None:
    means = dict.fromkeys(range(100), 30.0)
    lag_filter = LagFilter(means, 20.0, 5, Lag("first-order", 600.0))
    known = lag_filter.at(99)
    assert known.deviation == pytest.approx(10.0)
    assert known.known == pytest.approx(1.0, abs=1e-4)
    assert lag_filter.at(104) == (
        pytest.approx(10.0),
        pytest.approx(1.0, abs=1e-4),
        pytest.approx(1.0, abs=1e-3),
    )
    later = lag_filter.at(99 + 3 * 1440)
    assert later.known < 1e-6
    assert 0.0 < later.deviation <= 10.0
    assert later.inflation > 1.15
    means |= dict.fromkeys(range(99 + 3 * 1440, 99 + 3 * 1440 + 60), 25.0)
    again = lag_filter.at(99 + 3 * 1440 + 59)
    assert again.known > 0.99
    assert again.deviation == pytest.approx(5.0, abs=0.1)


def test_follower_that_was_never_told_anything_is_surer_of_nothing_than_after_a_week() -> None:
    never = LagFilter({}, 20.0, 5, Lag()).at(1000)
    assert never == Lagged(0.0, 0.0, pytest.approx(3.7, abs=0.1))


def test_rows_rest_on_periods_that_ended_a_period_ago() -> None:
    assert newest_period(np.array([0, 119_999_999_999, 120_000_000_000])).tolist() == [-2, -1, 0]


def hourly(seed: int, days: int, per_unit: float) -> tuple[FloatArray, FloatArray]:
    """Return hourly means of a parameter two hours behind a covariate, and the covariate on minutes."""
    rng = np.random.default_rng(seed)
    t = np.arange(days * 1440) / 1440
    doors = np.repeat(rng.standard_normal(days * 12), 120)
    hall = 5.0 * np.sin(2 * np.pi * t) + 3.0 * np.sin(2 * np.pi * t / 7.3 + seed) + 3.0 * doors
    lagged = series(np.arange(len(t)), hall, 0.0, 0).lagged(Lag("first-order", 7200.0))
    slow = np.zeros(len(t) // 60)
    for i in range(1, len(slow)):
        slow[i] = 0.8 * slow[i - 1] + 0.6 * rng.standard_normal()
    y = lagged.reshape(-1, 60).mean(axis=1) * per_unit + 0.5 * slow + 0.2 * rng.standard_normal(len(slow))
    return y, hall


def columns(hall: FloatArray, _: int, lag: Lag) -> FloatArray:
    return series(np.arange(len(hall)), hall, 0.0, 0).lagged(lag).reshape(-1, 60).mean(axis=1)


def test_regression_finds_coefficient_and_lag_within_what_it_says() -> None:
    deviations = []
    for seed in range(4):
        y, hall = hourly(seed, 20, -0.3)
        (one,) = regress(y, np.arange(len(y)), partial(columns, hall), 1, 20 * 86_400.0)
        assert one.significant
        assert one.lag.shape == "first-order"
        assert 4000.0 < one.lag.seconds < 12_000.0
        deviations.append((one.coefficient + 0.3) / one.sd)
    assert np.sqrt(np.mean(np.square(deviations))) < 1.8
    assert np.max(np.abs(deviations)) < 3.5


def test_regression_sees_nothing_where_there_is_nothing() -> None:
    matters = []
    for seed in range(3):
        y, hall = hourly(seed, 10, 0.0)
        (one,) = regress(y, np.arange(len(y)), partial(columns, hall), 1, 10 * 86_400.0)
        matters.append(one.significant)
        assert abs(one.coefficient) < 4 * one.sd
    assert sum(matters) <= 1


def test_lags_are_no_longer_than_an_eighth_of_the_stretch() -> None:
    assert lags(1000.0) == [Lag()]
    assert max(lag.seconds for lag in lags(8 * 86_400.0)) < 86_400.0


def test_covariates_that_move_together_are_named() -> None:
    x = np.random.default_rng(0).standard_normal((100, 2))
    assert alike(x) is None
    assert alike(np.column_stack([x, 3.0 * x[:, 0] + 1e-6])) == (0, 2)


def test_reference_is_wider_where_a_covariate_is_missing_or_beyond_what_was_learnt() -> None:
    sure = shift({"temperature": Lagged(4.0, 1.0, 1.0)}, [TEMPERATURE])
    assert sure == (pytest.approx(-0.3), pytest.approx(0.004))
    missing = shift({"temperature": Lagged(0.0, 0.0, 1.0)}, [TEMPERATURE])
    assert missing == (0.0, pytest.approx(0.45))
    cold = shift({"temperature": Lagged(-20.0, 1.0, 1.0)}, [TEMPERATURE])
    assert cold == (pytest.approx(1.5), pytest.approx(np.hypot(0.02, 0.5 * 0.075 * 5.0)))
    assert remark(TEMPERATURE, Lagged(4.0, 1.0, 1.0)) == ""
    assert (
        remark(TEMPERATURE, Lagged(0.0, 0.4, 1.0))
        == "temperature is missing, or has been for as long as it matters"
    )
    assert (
        remark(TEMPERATURE, Lagged(-20.0, 1.0, 1.0))
        == "temperature is outside the 5 to 35 degC that were learnt"
    )


def test_reference_moves_in_steps_so_that_rows_share_one() -> None:
    assert {stepped(25.0, moved, 0.1) for moved in (-0.04, 0.0, 0.049)} == {25.0}
    assert stepped(25.0, 0.26, 0.1) == pytest.approx(25.3)
    assert stepped(25.0, 0.26, 0.0) == 25.26
    assert widened(0.01, 0.0) == 0.01
    assert 0.1 < widened(0.01, 0.1) < 0.12
