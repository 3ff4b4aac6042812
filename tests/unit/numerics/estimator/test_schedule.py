"""When windows are learnt from."""

import numpy as np
import pytest

from agent.numerics.estimator.schedule import Disturbance, Schedule, eager_windows
from agent.numerics.estimator.tuning import BURST, EAGER, SELDOM, SELDOM_SAMPLES


def learnt(window: int, windows: int) -> list[int]:
    """Windows that are learnt from among so many, each as it falls due."""
    schedule, out = Schedule(window, eager_windows(window, 0.001)), []
    for number in range(windows):
        if number * window >= schedule.due:
            schedule.done(number * window)
            out.append(number)
    return out


@pytest.mark.parametrize("window", [50, 1000, 4000, 60_000])
def test_schedule_learns_from_the_first_windows_and_then_ever_more_seldom(window: int) -> None:
    found = learnt(window, 20_000)
    eager = eager_windows(window, 0.001)
    assert found[:eager] == list(range(eager))
    stretches = np.diff(found)
    assert np.all(np.diff(stretches) >= 0)
    assert stretches[-1] == max(SELDOM, SELDOM_SAMPLES // window)
    tens = [sum(n < 10**k * eager for n in found) for k in (1, 2)]
    assert tens[0] < eager + 16  # a few windows more for ten times as long
    assert tens[1] < tens[0] + 20


@pytest.mark.parametrize(
    ("window", "rate_hz", "eager"),
    [
        (100, 100.0, 32),  # a second each
        (250, 1000.0, 16),  # short ones
        (250, 20_000.0, 16),
        (300, 1000.0, 19),
        (1000, 1000.0, 12),  # 12,000 samples
        (60_000, 1000.0, 6),
    ],
)
def test_few_windows_are_learnt_from_in_a_row_where_they_are_short_or_long(
    window: int, rate_hz: float, eager: int
) -> None:
    assert eager_windows(window, 1.0 / rate_hz) == eager
    assert EAGER[0] <= eager <= EAGER[2]


def test_schedule_that_follows_learns_from_every_window_again() -> None:
    schedule = Schedule(1000, 12)
    for _ in range(60):
        schedule.done(schedule.due)
    assert schedule.due - schedule.tried == SELDOM * 1000
    schedule.follow(schedule.tried)
    assert schedule.due - schedule.tried == 1000


def test_schedule_passes_over_poor_windows_for_as_long_again_where_few_are_learnt_from() -> None:
    schedule = Schedule(1000, 12)
    assert schedule.overdue == schedule.due
    schedule.done(0)
    assert schedule.overdue == schedule.due
    for _ in range(60):
        schedule.done(schedule.due)
    assert schedule.overdue - schedule.due == SELDOM * 1000
    schedule.follow(schedule.due - 1000)  # long after the last one
    assert schedule.overdue == schedule.due  # every window is learnt from


def test_schedule_tries_windows_that_cannot_be_solved_ever_more_seldom() -> None:
    schedule, tries, index = Schedule(1000, 12), [], 0
    for _ in range(8):
        schedule.later(index, failed=True)
        tries.append(schedule.due - index)
        index = schedule.due
    assert tries == [250, 500, 1000, 2000, 4000, 8000, 8000, 8000]
    schedule.later(index)  # a change passes through the window: no failure
    assert schedule.due - index == 250
    schedule.done(index)
    schedule.later(index, failed=True)
    assert schedule.due - index == 250


def missed(cost: float, *, converged: bool, until: int, window: int = 1000) -> tuple[list[int], float]:
    """Samples at which a change that nothing explains is tried, by a budget of 1, and what is left of it.

    cost: of each try.
    """
    disturbance, left, tries = Disturbance(), 1.0, []
    disturbance.at(0)
    for index in range(0, until, 50):
        if index >= disturbance.again and left > 0:
            tries.append(index)
            share, left = min(cost / left, 1.0), left - cost
            disturbance.tried(index, window)
            disturbance.missed(index, window, share, converged=converged)
    return tries, left


def test_windows_that_do_not_converge_are_not_tried_again_until_most_of_them_is_behind_the_change() -> None:
    assert missed(0.1, converged=False, until=1000)[0] == [0, 800, 950]
    assert missed(0.01, converged=True, until=1000)[0] == list(range(0, 1000, 150))


def test_something_is_left_when_a_change_is_over_that_every_try_paid_for_in_vain() -> None:
    """Sixty evaluations each, of a burst: tries an eighth of a window apart would end after two windows."""
    tries, left = missed(60 / BURST, converged=False, until=8_000)
    assert left > 60 / BURST
    late = [n for n in tries if n > 1000]
    assert len(late) >= 6
    assert np.all(np.diff(np.diff(late)) >= -50)  # ever more patient
    assert late[1] < 1.5 * late[0]
