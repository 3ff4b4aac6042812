"""Covariates: their courses, what a machine feels of them, and what of a configuration is played."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from agent.config import load
from sim_bus.clock import PlayClock
from sim_bus.devices.device import Bench
from sim_bus.errors import SimUsageError
from sim_bus.rig.covariates.channel import CovariateChannel
from sim_bus.rig.covariates.course import Covariate, Covariates, Lagged
from sim_bus.rig.rigfile import RigFile, read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.rig.wear import Wear, WearPath
from tests.unit.config.test_covariates import HALL, THERMOMETER, put

T = np.array([0.0, 30.0, 60.0, 90.0, 1e4])


def hall(folder: Path = Path(), **keys: object) -> Covariates:
    courses = [Covariate.model_validate({"channel": "hall", **keys})]
    return Covariates([CovariateChannel(name="hall", unit="degC")], courses, folder)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"value": 3.0}, [3.0, 3.0, 3.0, 3.0, 3.0]),
        ({"kind": "sine", "value": 20.0, "amplitude": 4.0, "period_s": 120.0}, [20, 24, 20, 16, 23.464102]),
        ({"kind": "ramp", "value": 10.0, "to": 16.0, "over_s": 60.0}, [10.0, 13.0, 16.0, 16.0, 16.0]),
    ],
    ids=lambda value: value.get("kind", "constant") if isinstance(value, dict) else "",
)
def test_course_takes_the_values_that_its_kind_says(keys: dict[str, object], expected: list[float]) -> None:
    np.testing.assert_allclose(hall(**keys).true(T)[:, 0], expected, atol=1e-6)


def test_recorded_course_runs_straight_between_rows_again_and_again(tmp_path: Path) -> None:
    (tmp_path / "day.csv").write_text("t,T\n0,1.0\n60,3.0\n120,2.0\n", encoding="utf-8")
    played = hall(tmp_path, kind="recorded", file="day.csv", column="T", gain=2.0)
    found = played.true(np.array([0.0, 30.0, 60.0, 120.0, 150.0, 180.0]))
    np.testing.assert_allclose(found[:, 0], [2.0, 4.0, 6.0, 4.0, 3.0, 2.0])
    with pytest.raises(SimUsageError, match='column "T2" cannot be read'):
        hall(tmp_path, kind="recorded", file="day.csv", column="T2")


def test_courses_of_one_channel_add_up_and_one_without_a_course_stays_in_the_middle_of_its_range() -> None:
    channels = [CovariateChannel(name="hall"), CovariateChannel(name="load", range=(10.0, 30.0))]
    courses = [Covariate(channel="hall", value=2.0), Covariate(channel="hall", value=3.0)]
    found = Covariates(channels, courses, Path()).true(np.zeros(2))
    np.testing.assert_allclose(found, [[5.0, 20.0], [5.0, 20.0]])


def test_felt_follows_through_the_first_order_lag() -> None:
    played = hall(kind="sine", value=20.0, amplitude=5.0, period_s=300.0)
    solved = solve_ivp(
        lambda t, z: (played.true(np.array([t]))[0] - z) / 40.0, (0.0, 200.0), [20.0], rtol=1e-9, atol=1e-9
    )
    felt = Lagged(played, "hall", 40.0, 0.5)
    assert felt.at(400) == pytest.approx(solved.y[0, -1], abs=1e-3)
    assert Lagged(played, "hall", 0.0, 0.5).at(150) == pytest.approx(25.0)


def rig(folder: Path) -> RigFile:
    return read_rig(put(folder, HALL, THERMOMETER))


def test_springs_move_with_the_covariate_from_where_it_begins(tmp_path: Path) -> None:
    scenario = Scenario(
        covariate=(Covariate(channel="hall", kind="ramp", value=20.0, to=30.0, over_s=10.0),),
        wear=(Wear(kind="covariate", channel="hall", percent={"k1": -0.3}, rate={"k2": 1.0}),),
    )
    played = Rig(rig(tmp_path), scenario)
    at = played.timeline.values(5000)
    assert at["k1"] == pytest.approx(25.0 * (1.0 - 0.003 * 5.0))
    assert at["k2"] == pytest.approx(100.0 + 5.0)
    np.testing.assert_allclose(played.advance(3).covariates[:, 0], [20.0, 20.001, 20.002])


def test_wear_counts_from_its_center_and_from_its_own_beginning() -> None:
    played = hall(kind="ramp", value=20.0, to=30.0, over_s=10.0)
    keys = {"kind": "covariate", "channel": "hall", "rate": {"k1": 2.0}, "every_s": 1.0}
    paths = [_path(played, **keys, center=15.0), _path(played, **keys, from_s=4.0)]
    assert [path.offset("k1", 6_000) for path in paths] == pytest.approx([22.0, 12.0])
    assert paths[1].offset("k1", 3_999) == 0.0


def _path(played: Covariates, **keys: object) -> WearPath:
    return WearPath(Wear.model_validate(keys), 1000.0, (0,), {"k1": 25.0}, played)


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"covariate": [{"channel": "hal"}]}, "covariate.channel: hal: the configuration has no channel of"),
        ({"covariate": [{"channel": "x1"}]}, "its covariates are hall"),
        ({"wear": [{"kind": "covariate", "channel": "oil", "rate": {"k1": 1.0}}]}, "wear.channel: oil"),
    ],
)
def test_scenario_of_another_covariate_is_refused(tmp_path: Path, table: dict[str, Any], words: str) -> None:
    with pytest.raises(SimUsageError, match=words):
        Rig(rig(tmp_path), Scenario.model_validate(table))


@pytest.mark.parametrize(
    "keys",
    [
        {"kind": "covariate", "rate": {"k1": 1.0}},
        {"kind": "walk", "rate": {"k1": 1.0}, "channel": "hall"},
        {"kind": "walk"},
    ],
)
def test_wear_that_does_not_say_what_it_follows_or_moves_is_refused(keys: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"channel names the covariate|names no parameter"):
        Wear.model_validate(keys)


def test_simulator_plays_covariates_beside_the_signals(tmp_path: Path) -> None:
    played, plain = rig(tmp_path), load(put(tmp_path))
    assert [channel.name for channel in played.channel] == [channel.name for channel in plain.channel]
    assert [one.name for one in played.covariate] == ["hall"]
    assert played.source_names == ("modbus", "thermometer")
    assert played.signal_sources == ("modbus",)
    assert played.rate_hz(1) == 1.0
    # the clock waits for nobody who reads covariates alone
    assert PlayClock(1000.0, None, played.signal_sources, "reader").unmet() == ("modbus",)


def test_covariates_alone_cannot_be_played_faster_than_they_are_read(tmp_path: Path) -> None:
    played = rig(tmp_path)
    clock = PlayClock(1000.0, None, played.signal_sources, "reader", fast=True)
    bench = Bench(played, Trajectory(Rig(played, Scenario())), clock, Scenario())
    assert bench.clock_of(0) is clock
    with pytest.raises(SimUsageError, match='--fast: source "thermometer": covariates are read by the clock'):
        bench.clock_of(1)
