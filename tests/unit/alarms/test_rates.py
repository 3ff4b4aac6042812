"""Measures of an alarm system against their definitions, counted by hand and by another way."""

import random

from agent.alarms.rates import TEN_MINUTES_NS, Announced, Flood, floods_of, most_within, rates
from agent.units import DAY_NS, MINUTE_NS

K1, K2 = ("press-7", "level", "k1"), ("press-7", "level", "k2")


def announced(*minutes: float, key: tuple[str, str, str] = K1, priority: str = "low") -> list[Announced]:
    return [Announced(round(minute * MINUTE_NS), key, priority) for minute in minutes]


def test_rates_count_what_was_announced_a_day() -> None:
    found = rates(announced(1, 100, 200) + announced(50, key=K2, priority="high"), {}, 0, 2 * DAY_NS)
    assert (found.days, found.announced, found.a_day) == (2.0, 4, 2.0)
    assert (found.frequent, dict(found.priorities)) == ([(K1, 3), (K2, 1)], {"low": 3, "high": 1})
    assert (found.floods, dict(found.chattering), dict(found.stale)) == ([], {}, {})


def test_flood_begins_with_the_eleventh_alarm_in_ten_minutes_and_lasts_while_five_come() -> None:
    ten = [minute * MINUTE_NS // 2 for minute in range(10)]
    assert floods_of(ten) == []
    eleven = [*ten, 5 * MINUTE_NS]
    assert floods_of(eleven) == [Flood(0, 5 * MINUTE_NS, 11)]
    slow = [5 * MINUTE_NS + n * 105 * 10**9 for n in range(1, 10)]  # some five in ten minutes: it goes on
    assert floods_of([*eleven, *slow]) == [Flood(0, slow[-1], 20)]
    assert floods_of([*eleven, 3 * TEN_MINUTES_NS]) == [Flood(0, 5 * MINUTE_NS, 11)]


def test_chattering_is_three_within_a_minute() -> None:
    assert dict(rates(announced(0, 0.5, 1.0), {}, 0, DAY_NS).chattering) == {}
    assert dict(rates(announced(0, 0.5, 0.99), {}, 0, DAY_NS).chattering) == {K1: 3}


def test_stale_is_what_has_stood_for_more_than_a_day() -> None:
    assert dict(rates([], {K1: 0, K2: MINUTE_NS}, 0, DAY_NS + MINUTE_NS).stale) == {K1: 0}


def test_fullest_stretch_is_that_which_trying_all_finds() -> None:
    rng = random.Random(5)
    for _ in range(30):
        times = sorted(rng.randrange(10**6) for _ in range(40))
        length = rng.randrange(1, 10**6)
        assert most_within(times, length) == max(
            sum(t <= other < t + length for other in times) for t in times
        )
