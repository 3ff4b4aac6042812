"""Forecasts that the agent makes: stored, scored once, blind to later rows, and no danger to anybody."""

import json
import os
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scoringrules

from agent.blocks.advisory.prognosis_alarms import PrognosisAlarms
from agent.cli.prognosis.trend import document
from agent.config import Forecast as Asked
from agent.config import RigConfig
from agent.records import ForecastRecord, ForecastScore, HealthEvent, Record, TrendRecord
from agent.runtime.forecasts.making import Forecaster, Made
from agent.runtime.forecasts.replayed import ReplayedForecasts
from agent.runtime.forecasts.schedule import Schedule
from agent.runtime.forecasts.thread import ForecastThread
from agent.storage.read import queries
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import EstimateBatch
from tests.storage.rows import START, batch, run_info, step
from tests.unit.config.config_texts import PRESS, read, with_fake_driver

DAY_NS = 86_400 * 10**9
FALL = 40
"""Days until k1 has fallen from 25 to 25 - 5."""


@pytest.fixture(autouse=True)
def _fake_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    with_fake_driver(monkeypatch)


@pytest.fixture
def rig() -> RigConfig:
    text = PRESS.replace("limit = 15.0", "limit = 5.0").replace("deadband = 1.5", "deadband = 0.5")
    return read(text).model_copy(update={"forecast": Asked(every="1d")})


def falling(first: int, days: int) -> EstimateBatch:
    """A row a day of k1, which falls by 5 in FALL days, and of the others, which stay."""
    day = np.arange(first, first + days)
    rng = np.random.default_rng(7)
    noise = 0.05 * rng.standard_normal((200, 4))[day]
    value = np.array([25.0, 100.0, 5.0, 5.0]) - np.outer(day, [5.0 / FALL, 0.0, 0.0, 0.0]) + noise
    sd = np.full(value.shape, 0.05)
    return batch(
        days, first=first, hop_ns=DAY_NS, value=value, sd=sd, sd_repeat=sd,
        parameters=("k1", "k2", "B1", "B2"),
        reference=np.array([25.0, 100.0, 5.0, 5.0]),
    )  # fmt: skip


def store(path: Path, *records: Record) -> Path:
    with Store.open(path) as opened:
        opened.write(opened.begin_run(run_info()), list(records))
    return path


def made(rig: RigConfig, path: Path, until_day: int | None = None) -> ForecastRecord:
    until = None if until_day is None else START + until_day * DAY_NS
    (record,) = (
        r for r in Forecaster(rig, path).make("due", ("k1",), until).records if isinstance(r, ForecastRecord)
    )
    return record


def test_forecast_is_of_the_limit_that_the_parameter_moves_to(rig: RigConfig, tmp_path: Path) -> None:
    record = made(rig, store(tmp_path / "a.db", falling(0, 30)))
    assert (record.rig, record.parameter, record.limit, record.status) == ("press-7", "k1", 20.0, "ok")
    assert record.t_ns == START + 29 * DAY_NS
    assert record.p10_ns is not None
    assert record.p90_ns is not None
    assert record.p10_ns < START + FALL * DAY_NS < record.p90_ns
    draws = json.loads(record.draws)
    assert len(draws) == 40
    assert draws == sorted(draws)
    assert sum(json.loads(record.family).values()) == pytest.approx(1.0, abs=1e-3)


def test_trend_is_stored_as_the_command_says_it_of_parameters_without_alarms_too(
    rig: RigConfig, tmp_path: Path
) -> None:
    path = store(tmp_path / "a.db", falling(0, 30))
    forecaster = Forecaster(rig, path)
    assert set(forecaster.parameters) > {alarm.parameter for alarm in rig.alarm}
    found = {
        record.parameter: record
        for record in forecaster.make("due", forecaster.parameters).records
        if isinstance(record, TrendRecord)
    }
    assert set(found) == {"k1", "k2", "B1", "B2"}
    for name, record in found.items():
        said = document(path, name, None, (None, None), None)
        columns = ("value", "sd", "slope_per_day", "slope_sd", "trend")
        assert [getattr(record, column) for column in columns] == [said[column] for column in columns]
    assert found["k1"].trend
    assert found["k1"].slope_per_day == pytest.approx(-5.0 / FALL, abs=4 * (found["k1"].slope_sd or 0.0))


def test_forecast_is_the_same_to_the_last_bit_whether_later_rows_exist_or_not(
    rig: RigConfig, tmp_path: Path
) -> None:
    short = store(tmp_path / "short.db", falling(0, 20))
    whole = store(tmp_path / "whole.db", falling(0, 38))
    assert made(rig, whole, 19) == made(rig, short)
    assert made(rig, whole) != made(rig, short)


def test_forecast_is_scored_once_as_scoringrules_does(rig: RigConfig, tmp_path: Path) -> None:
    path = tmp_path / "a.db"
    with Store.open(path) as opened:
        run = opened.begin_run(run_info())
        opened.write(run, [falling(0, 30)])
        opened.write(run, list(Forecaster(rig, path).make("due", ("k1",)).records))
        opened.write(run, [falling(30, 15)])
        found = Forecaster(rig, path).make("due", ("k1",))
        opened.write(run, list(found.records))
        again = Forecaster(rig, path).make("due", ("k1",))
    assert sum(isinstance(r, ForecastScore) for r in found.records) == 1
    assert not any(isinstance(r, ForecastScore) and r.number == 1 for r in again.records)
    row = queries.forecasts(path)[0]
    came = (row["crossed_ns"] - row["made_at_ns"]) / 1e9
    assert came == pytest.approx((FALL - 29) * 86_400.0, abs=86_400.0)
    oracle = float(scoringrules.crps_ensemble(came, np.array(json.loads(row["draws"])), estimator="nrg"))
    assert row["crps"] == pytest.approx(oracle, rel=1e-9)
    assert row["held"] == int(row["p10_ns"] <= row["crossed_ns"] <= row["p90_ns"])
    assert queries.forecasts(path)[1]["status"] == "crossed"


def test_forecast_after_which_no_row_came_awaits_its_score(rig: RigConfig, tmp_path: Path) -> None:
    path = store(tmp_path / "a.db", falling(0, 30))
    with Store.open(path) as opened:
        opened.write(opened.begin_run(run_info()), list(Forecaster(rig, path).make("due", ("k1",)).records))
    found = Forecaster(rig, path).make("start", ("k1",)).records
    assert sorted(type(r).__name__ for r in found) == ["ForecastRecord", "TrendRecord"]


def test_forecast_of_what_never_comes_is_scored_when_its_time_has_long_passed(
    rig: RigConfig, tmp_path: Path
) -> None:
    path = tmp_path / "a.db"
    falls = falling(30, 90)
    stays = replace(falls, value=falls.value + np.outer(np.arange(30, 120) - 29.0, [0.125, 0, 0, 0]))
    with Store.open(path) as opened:
        run = opened.begin_run(run_info())
        opened.write(run, [falling(0, 30)])
        opened.write(run, list(Forecaster(rig, path).make("due", ("k1",)).records))
        opened.write(run, [stays])
        opened.write(run, list(Forecaster(rig, path).make("due", ("k1",)).records))
    row = queries.forecasts(path)[0]
    assert (row["crossed_at"], row["held"]) == (None, 0)
    until = (row["scored_ns"] - row["made_at_ns"]) / 1e9
    draws = np.minimum(json.loads(row["draws"]), until)
    assert row["crps"] == pytest.approx(
        float(scoringrules.crps_ensemble(until, draws, estimator="nrg")), rel=1e-9
    )


def test_history_of_a_moment_is_too_short_without_a_look(rig: RigConfig, tmp_path: Path) -> None:
    moment = replace(falling(0, 30), t_ns=START + np.arange(30) * 50_000_000)
    record = made(rig, store(tmp_path / "a.db", moment))
    assert (record.status, record.p50_ns, record.chance, record.draws) == ("too short", None, None, "[]")


def test_side_and_horizon_of_the_configuration_are_kept(rig: RigConfig, tmp_path: Path) -> None:
    alarm = rig.alarm[0].model_copy(update={"side": "high"})
    asked = rig.model_copy(update={"alarm": (alarm,), "forecast": Asked(every="60s", horizon="5d")})
    record = made(asked, store(tmp_path / "a.db", falling(0, 30)))
    assert (record.limit, record.status, record.horizon_s) == (30.0, "beyond", 5 * 86_400.0)


def test_parameter_without_rows_has_no_forecast(rig: RigConfig, tmp_path: Path) -> None:
    path = tmp_path / "a.db"
    with Store.open(path) as opened:
        opened.begin_run(run_info())
    assert Forecaster(rig, path).make("due", ("k1",)) == Made()


@pytest.mark.parametrize("wrong", ["no file", "like"])
def test_failure_is_one_event_and_nothing_else(rig: RigConfig, tmp_path: Path, wrong: str) -> None:
    path = tmp_path / "a.db"
    if wrong == "like":
        store(path, falling(0, 30))
        (tmp_path / "prior.json").write_text("[]")
        asked = Asked(every="60s", like=(tmp_path / "prior.json",))
        rig = rig.model_copy(update={"forecast": asked})
    forecaster = Forecaster(rig, path)
    (event,) = forecaster.make("due", ("k1",)).records
    assert isinstance(event, HealthEvent)
    assert (event.source, event.cause) == ("forecast", "failure")
    assert event.message.startswith("no forecast of k1: ")
    assert forecaster.make("due", ("k1",)) == Made()


def test_schedule_is_due_once_a_period_and_bounded_after_a_gap() -> None:
    schedule = Schedule(10.0)
    assert schedule.due(0) == []
    assert schedule.due(9_999_999_999) == []
    assert schedule.due(31_000_000_000) == [10 * 10**9, 20 * 10**9, 30 * 10**9]
    assert len(schedule.due(10**15)) == 100
    assert Schedule(float("inf")).due(10**18) == []
    started = Schedule(3600.0, 600.0)
    assert started.due(0) == []
    assert started.due(4300 * 10**9) == [600 * 10**9, 4200 * 10**9]


def test_schedule_asks_at_level_alarms_and_not_at_each_of_a_chattering_one() -> None:
    schedule = Schedule(60.0)
    assert schedule.at_alarms([step("NORM", "UNACK"), step("NORM", "UNACK", kind="sensor")]) == [
        (START, "k1")
    ]
    assert schedule.at_alarms([step("UNACK", "RTNUN", START + 10**8)]) == []
    assert schedule.at_alarms([step("RTNUN", "UNACK", START + 10**9)]) == [(START + 10**9, "k1")]


class Slow:
    """A forecaster that waits until it may go on."""

    rig = "press"

    def __init__(self) -> None:
        self.begun, self.free = threading.Event(), threading.Event()
        self.asked: list[tuple[str, Sequence[str]]] = []

    def make(self, cause: str, parameters: Sequence[str], until_ns: int | None = None) -> Made:
        self.asked.append((cause, parameters))
        self.priority = os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
        self.begun.set()
        self.free.wait(10.0)
        return Made()


@pytest.mark.realtime
def test_thread_makes_what_is_asked_once_and_is_not_waited_for() -> None:
    slow: Any = Slow()
    thread = ForecastThread({"press": slow}, settle_s=0.0)
    thread.start()
    thread.ask("press", "k1", "due")
    assert slow.begun.wait(5.0)
    assert slow.priority > os.getpriority(os.PRIO_PROCESS, threading.get_native_id())
    for _ in range(3):
        thread.ask("press", "k2", "alarm")
    assert thread.take("press") == []
    begun = time.monotonic()
    thread.stop()
    assert time.monotonic() - begun < 0.2
    slow.free.set()
    thread._thread.join(5.0)
    assert slow.asked == [("due", ("k1",))]
    assert thread.take("press") == [Made()]


def test_life_of_a_part_is_forecast_alarmed_and_scored(rig: RigConfig, tmp_path: Path) -> None:
    """A part that falls for FALL days, seen day by day: the alarm comes before the limit, and the record is
    kept."""
    alarm = rig.alarm[0].model_copy(update={"within": 12 * 86_400.0})
    rig = rig.model_copy(update={"alarm": (alarm,), "forecast": Asked(every="6d")})
    path = tmp_path / "life.db"
    writer = StoreWriter(lambda: Store.open(path), [run_info(kind="replay")], lossless=True)
    writer.start()
    forecasts = ReplayedForecasts(rig, path, lambda: writer.flush(60.0))
    alarms = PrognosisAlarms("press-7", rig.alarm)
    for first in range(0, 54, 3):
        rows = falling(first, 3)
        writer.publish([rows])
        for found in forecasts.step([rows]):
            changes = [change for outlook in found.outlooks for change in alarms.step(outlook)]
            writer.publish([*found.records, *changes])
    writer.stop()
    made_at = [(row["made_at_ns"] - START) // DAY_NS for row in queries.forecasts(path)]
    assert made_at == [6, 12, 18, 24, 30, 36, 42, 48]
    (raised,) = queries.alarms(path)
    assert (raised["kind"], raised["parameter"], raised["state"]) == ("forecast", "k1", "UNACK")
    assert "2026-01-25" <= raised["raised_at"] < "2026-02-06"
    scored = [row for row in queries.forecasts(path) if row["held"] is not None]
    assert {row["crossed_at"][:10] for row in scored} <= {"2026-02-09", "2026-02-10", "2026-02-11"}
    assert len(scored) >= 4
    assert sum(row["held"] for row in scored) >= len(scored) - 1
    assert [row["status"] for row in queries.forecasts(path)][-2:] == ["crossed", "crossed"]
