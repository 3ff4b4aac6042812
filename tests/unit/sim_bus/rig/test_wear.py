"""Parameters that wander and that follow the temperature; blows of a hammer."""

import math
from pathlib import Path

import numpy as np
import pytest

from sim_bus.rig.excitation import Force, ForceStream
from sim_bus.rig.schedule import Change, Timeline
from sim_bus.rig.wear import Wear, WearPath


def path(**keys: object) -> WearPath:
    return WearPath(Wear.model_validate({"rate": {"k1": 2.0}, **keys}), 1000.0, (5, 6, 0))


def test_walk_spreads_with_the_root_of_time() -> None:
    ends = [
        WearPath(Wear(kind="walk", rate={"k1": 2.0}), 1000.0, (seed,)).offset("k1", 9_000)
        for seed in range(400)
    ]
    assert np.std(ends) == pytest.approx(2.0 * 3.0, rel=0.1)


def test_walk_is_the_same_whoever_asks_and_in_whatever_order() -> None:
    one, other = path(kind="walk"), path(kind="walk")
    late = other.offset("k1", 5_000)
    assert [one.offset("k1", i) for i in (0, 49, 50, 2_000, 5_000)][-1] == late
    assert one.offset("k1", 49) == one.offset("k1", 0) != one.offset("k1", 50)
    assert one.offset("B1", 5_000) == 0.0


def test_temperature_is_a_sine_of_the_degrees_times_what_one_does() -> None:
    wear = path(kind="temperature", amplitude=10.0, period_s=4.0, every_s=0.5)
    assert [wear.offset("k1", i) for i in (0, 1000, 1499)] == pytest.approx([0.0, 20.0, 20.0])
    assert wear.offset("k1", 1500) == pytest.approx(20.0 * math.sin(0.75 * math.pi))


def test_wear_lasts_from_its_beginning_to_its_end_and_stays_there() -> None:
    wear = path(kind="temperature", amplitude=1.0, period_s=4.0, from_s=1.0, until_s=2.0, every_s=0.1)
    assert wear.offset("k1", 999) == 0.0
    assert wear.offset("k1", 9_999) == pytest.approx(2.0)
    assert (wear.next_after(0), wear.next_after(1000), wear.next_after(2000)) == (1000, 1100, None)


def test_timeline_adds_wear_to_its_schedule_and_cuts_where_it_moves() -> None:
    wear = path(kind="temperature", amplitude=10.0, period_s=4.0, every_s=0.5)
    line = Timeline({"k1": 100.0}, [Change(at_s=1.2, delta={"k1": 7.0})], 1000.0, [wear])
    cuts = [(first, end) for first, end, _ in line.segments(0, 1600)]
    assert cuts == [(0, 500), (500, 1000), (1000, 1200), (1200, 1500), (1500, 1600)]
    assert line.values(1200)["k1"] == pytest.approx(100.0 + 7.0 + 20.0)


def test_impacts_differ_by_their_spread_and_do_not_depend_on_how_they_are_taken() -> None:
    force = Force(kind="impacts", amplitude=100.0, period_s=0.1, width_s=0.01, spread=0.3)

    def blows(cut: int) -> np.ndarray:
        stream = ForceStream([(force, "m1")], ["m1"], 1000.0, 3, Path())
        return np.concatenate([stream.take(cut)[:, 0] for _ in range(60_000 // cut)])

    whole = blows(60_000)
    np.testing.assert_array_equal(whole, blows(750))
    peaks = whole.reshape(-1, 100)[:, 5]
    assert np.std(peaks) == pytest.approx(30.0, rel=0.1)
    assert np.mean(peaks) == pytest.approx(100.0, rel=0.1)
    assert np.abs(whole.reshape(-1, 100)[:, 10:]).max() < 1e-6
