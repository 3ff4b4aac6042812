"""Readings of so many significant digits: what is found of them, and by how much they tell less."""

from dataclasses import replace

import numpy as np
import pytest

from agent.numerics.estimator.memory import from_text, to_text
from agent.numerics.estimator.record import Record
from agent.numerics.inference.noise.rounding import (
    Rounding,
    RoundingErrors,
    reference,
    rounding_after,
    significant_digits,
)
from agent.numerics.preprocessing.wire import Wire
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import learner_of, record

ONE, SI = Wire.in_si(1), Wire.in_si(2)


def as_a_table(y: np.ndarray, digits: int) -> np.ndarray:
    """Readings as text of so many significant digits gives them."""
    return np.array([float(f"{x:.{digits}g}") for x in y.ravel()]).reshape(y.shape)


def motion(count: int = 2000, seed: int = 3) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 0.06 * np.sin(0.03 * np.arange(count))[:, None] * np.array(
        [1.0, 2.0]
    ) + 1e-4 * rng.standard_normal((count, 2))


@pytest.mark.parametrize("digits", [2, 3, 4])
@pytest.mark.parametrize("unit", [1.0, 1e-3, 1e-6])
def test_significant_digits_are_found_in_any_decimal_unit(digits: int, unit: float) -> None:
    found, uneven = significant_digits(as_a_table(motion(), digits) * unit)
    assert found.tolist() == [digits, digits]
    assert uneven.all()


def test_whole_steps_and_doubles_are_rounded_evenly() -> None:
    y = motion()
    for even in (np.round(y, 3), np.rint(y * 1e5), y, np.zeros_like(y)):
        assert not significant_digits(even)[1].any()
        assert rounding_after(None, even, SI) is None


def test_digits_are_kept_while_a_window_shows_no_others() -> None:
    y = as_a_table(motion(), 3)
    known = rounding_after(None, y, SI)
    assert known is not None
    small = as_a_table(0.5 + 0.1 * motion(), 3)  # one decade: of itself it shows one step
    assert rounding_after(None, small, SI) is None
    again = rounding_after(known, small, SI)
    assert again is not None
    assert again.digits.tolist() == [3, 3]
    assert rounding_after(known, motion(), SI) is None


def test_variance_is_that_of_the_step_at_the_reading() -> None:
    known = Rounding(np.array([3, 0]), SI, np.zeros(2), np.zeros(2), np.zeros(2))
    y = np.array([[0.0987, 0.0987], [0.101, 0.101], [12.3, 12.3]])
    np.testing.assert_allclose(known.variance(y)[:, 0], np.array([1e-4, 1e-3, 0.1]) ** 2 / 12)
    assert not known.variance(y)[:, 1].any()


def test_table_of_scaled_readings_is_known_by_what_it_was_written_in() -> None:
    table = as_a_table(motion(), 3)
    wire = Wire(np.array([9.80665, 0.0254]), np.array([2.0, -0.3]))
    y = table * wire.unit + wire.zero
    assert rounding_after(None, y, SI) is None
    known, plain = rounding_after(None, y, wire), rounding_after(None, table, SI)
    assert known is not None
    assert plain is not None
    np.testing.assert_allclose(known.variance(y), plain.variance(table) * wire.unit**2)


def test_factors_are_the_sandwich_of_weighted_least_squares() -> None:
    # one parameter with x as its column: each variance in closed form
    rng = np.random.default_rng(1)
    x = rng.uniform(0.01, 0.2, (500, 1))  # no reading twice
    sigma2, cut = 2e-9, 180
    known = Rounding(np.array([3]), ONE, np.array([4e-9]), np.array([1 / 6e-9]), np.array([1 / 6e-9]))
    uneven = RoundingErrors(100, x, known)
    true = sigma2 + known.variance(x).ravel()
    assumed = sigma2 + known.usual[0]
    weight = x.ravel() ** 2
    start, stop = np.array(100), np.array(600)
    told = (weight @ true) / weight.sum() / assumed
    assert uneven.inflation(start, stop) == pytest.approx(told, rel=1e-12)
    assert uneven.power(start, stop) == pytest.approx(true.mean() / assumed, rel=1e-12)
    assert uneven.count(start, stop) == pytest.approx(true.sum() ** 2 / (true**2).sum(), rel=1e-12)
    # score of a jump: the column after the cut less what the parameter takes of it
    after = np.where(np.arange(500) >= cut, x.ravel(), 0.0)
    left = after - x.ravel() * (after @ x.ravel()) / weight.sum()
    score = (left**2 @ true) / (left @ after) / assumed
    assert uneven.jump(start, np.array(100 + cut), stop) == pytest.approx(score, rel=1e-12)


def test_readings_quieter_than_filters_count_on_are_not_relied_on() -> None:
    fine = as_a_table(motion() / 10, 3)[:, :1] + 0.02  # less than 0.1: a hundredth of the usual variance
    known = Rounding(np.array([3]), ONE, np.array([1e-3]) ** 2 / 12, np.full(1, 1e7), np.full(1, 1e7))
    errors = RoundingErrors(0, fine, known)
    start, cut, stop = np.array(0), np.array(700), np.array(len(fine))
    assert errors.power(start, stop) == errors.inflation(start, stop) == errors.jump(start, cut, stop) == 1.0


def test_a_code_that_repeats_itself_counts_more_each_time() -> None:
    known = Rounding(np.array([3]), ONE, np.zeros(1), np.ones(1), np.ones(1))
    fresh, repeated = np.array([[0.123], [0.124], [0.123], [0.124]]), np.full((4, 1), 0.123)
    each = [RoundingErrors(0, y, known).inflation(np.array(0), np.array(4)) - 1 for y in (fresh, repeated)]
    assert each[1] / each[0] == pytest.approx((1 + 2 + 3 + 4) / 4)


def test_filters_count_on_the_mean_precision_of_windows() -> None:
    fine, coarse = (
        Rounding(np.array([3]), ONE, np.array([v]), np.zeros(1), np.zeros(1)) for v in (1.0, 100.0)
    )
    assert reference(None, coarse, 1.0) == pytest.approx([100.0])
    assert reference(fine, coarse, 0.25) == pytest.approx([1 / (0.75 + 0.0025)])


def test_record_gives_rows_the_same_however_many_are_asked_for() -> None:
    y = as_a_table(motion(), 3)
    kept = Record(7, 2, 1)
    kept.append(y, np.ones((len(y), 1)), None)
    known = rounding_after(None, y, SI)
    assert known is not None
    known = replace(known.at(y), of_power=np.full(2, 1e7), of_score=np.full(2, 1e7))
    index = np.arange(7 + 999, 7 + 1999, 50)
    all_at_once = kept.rounding_errors_in(index, 500, known)
    assert all_at_once is not None
    together = all_at_once.inflation(index + 1 - 500, index + 1)
    assert np.ptp(together) > 0.05
    for i, one in zip(index, together, strict=True):
        alone = kept.rounding_errors_in(np.array([i]), 500, known)
        assert alone is not None
        assert alone.inflation(i + 1 - 500, i + 1) == pytest.approx(one, rel=1e-9)


def test_windows_are_learnt_from_and_remembered_with_their_rounding() -> None:
    rig, rng = ChainRig(), np.random.default_rng(2)
    noise = DenseNoise(np.array([1e-4, 2e-4]), np.zeros(2))
    learner = learner_of(rig)
    known = learner.prior(noise.sigma, np.full(2, 0.3))
    fresh = known
    for _ in range(4):
        window = record(rig, rng, noise)[0]
        posterior, known = learner.learn(replace(window, y=as_a_table(window.y, 2)), known)
        assert posterior.holds
    assert known.noise.rounding is not None
    assert known.noise.rounding.digits.tolist() == [2, 2]
    # σ is the sensors' own beside it
    assert np.abs(known.noise.log_sigma - np.log(noise.sigma)).max() < 0.3
    again = from_text(to_text(known), fresh, learner.wire)
    assert again is not None
    assert to_text(again) == to_text(from_text(to_text(again), fresh, learner.wire))  # type: ignore[arg-type]
    assert again.noise.rounding is not None
    np.testing.assert_allclose(again.noise.rounding.usual, known.noise.rounding.usual, rtol=1e-8)
    # as evenly rounded readings come, there is nothing left of it
    assert learner.learn(record(rig, rng, noise)[0], known)[1].noise.rounding is None
