"""Which units of a Modbus line are asked when: shares of the line, pauses, how long each is waited for."""

import random

import pytest

from drivers.modbus.tuning import PATIENCE
from drivers.modbus.units import Unit


def lost(cost_s: float, failures: int) -> Unit:
    unit = Unit()
    for _ in range(failures):
        unit.failed(cost_s, 0.0, silent=True)
    return unit


def busy(next_at: float, every_s: float, answers_s: float = 0.004) -> Unit:
    return Unit(next_at=next_at, every_s=every_s, slowest_s=answers_s)


@pytest.mark.parametrize(
    ("cost_s", "shares"),
    [
        (0.01, [0.2, 1 / 17, 1 / 65, 0.01, 0.01]),
        (0.05, [0.2, 1 / 17, 0.05 / 1.4, 0.05 / 1.4]),
        (0.15, [0.2, 0.15 / 1.4, 0.15 / 1.4]),
        (0.5, [0.25, 0.25, 0.25]),
    ],
)
def test_unit_that_keeps_silent_takes_ever_less_of_the_line(cost_s: float, shares: list[float]) -> None:
    for failures, share in enumerate(shares, PATIENCE):
        rest_s = lost(cost_s, failures).rest_until
        assert cost_s / (cost_s + rest_s) == pytest.approx(share)
    assert lost(cost_s, PATIENCE - 1).rest_until == 0.0
    assert lost(cost_s, 1000).rest_until == pytest.approx(cost_s / shares[-1] - cost_s)


def test_unit_that_answers_or_refuses_is_not_left_alone() -> None:
    unit = lost(0.05, 9)
    unit.failed(0.05, 0.0, silent=False)
    assert (unit.rest_until, unit.is_lost) == (0.0, False)
    unit = lost(0.05, 9)
    unit.answered(0.01)
    assert not unit.is_lost


def test_unit_that_is_lost_waits_its_rest_and_then_for_the_longest_pause_of_the_others() -> None:
    unit = lost(0.05, 9)
    others = [busy(10.0 + at, 0.1) for at in (0.02, 0.024, 0.028, 0.060)]
    assert unit.start(1.0, others) == unit.rest_until
    assert unit.start(10.0, others) == pytest.approx(10.064)
    assert unit.start(10.064, others) == pytest.approx(10.064)
    assert unit.start(10.3, others) <= 10.3  # it was late itself: no second pause is sought


def test_unit_that_is_lost_and_alone_is_asked_at_once() -> None:
    assert lost(0.05, 9).start(0.0, []) == 0.0


def test_request_that_fits_before_the_others_goes_at_once() -> None:
    assert lost(0.01, 9).start(10.0, [busy(10.02, 0.1)]) == 10.0


def test_pause_is_sought_nearby_only() -> None:
    rng = random.Random(1)
    for _ in range(200):
        others = [
            busy(10.0 + rng.uniform(0, 3), rng.choice([0.0, 0.02, 0.5, 5.0]))
            for _ in range(rng.randint(1, 6))
        ]
        assert 10.0 <= lost(rng.uniform(0.01, 2.0), 20).start(10.0, others) <= 10.2 + 1e-9


def test_periods_are_learnt_from_requests_and_what_is_due_follows() -> None:
    unit = Unit()
    for urgent_at in (5.0, 5.0, 5.1, 5.2):
        unit.plan(urgent_at)
    assert unit.next_at == 5.2
    assert unit.every_s == pytest.approx(0.1)
    assert unit.due_after(4.0) == 5.2
    assert unit.due_after(5.55) == pytest.approx(5.6)
    assert unit.is_active(6.0)
    assert not unit.is_active(6.3)


@pytest.mark.parametrize(("slowest_s", "whole"), [(0.0, {0, 16, 64, 256}), (0.002, {0, 64, 256})])
def test_silent_unit_is_given_its_whole_time_ever_more_seldom(slowest_s: float, whole: set[int]) -> None:
    times = {n: Unit(slowest_s=slowest_s, unanswered=n).allowed_s(0.5, 0.004) for n in range(300)}
    assert {n for n, seconds in times.items() if seconds == 0.5} == whole
    assert set(times.values()) == {0.5, 0.05}
    assert Unit(unanswered=5).allowed_s(0.5, 0.0) == 0.5


def test_unit_whose_answers_come_late_is_waited_for_longer() -> None:
    unit = lost(0.05, 9)
    unit.slowest_s = 0.004
    unit.late(0.08)
    assert unit.allowed_s(0.5, 0.004) == pytest.approx(0.32)
    assert unit.cost_s == 0.08
