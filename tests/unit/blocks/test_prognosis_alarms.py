"""Alarms of kind forecast and rate: raised by what a history leads to, cleared with hysteresis."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from agent.blocks.advisory.outlook import Outlook
from agent.blocks.advisory.prognosis_alarms import PrognosisAlarms
from agent.prognosis.change import Change, Rates
from agent.prognosis.forecast import Forecast, Status
from agent.types import AlarmTransition

DAY = 86_400.0


@dataclass(frozen=True)
class Rule:
    parameter: str = "k1"
    kinds: tuple[str, ...] = ("level", "forecast", "rate")
    side: str = "both"
    confidence: float = 0.95
    priority: str = "high"
    within: float | None = 30 * DAY
    rate_per_day: float | None = 0.5
    advice: str | None = None


def change(slope: float, sd: float) -> Change:
    rates = Rates(np.array([slope]), np.array([sd]), np.array([1.0]))
    return Change(24.0, 0.1, slope, sd, slope, sd, 0.0, 1.0, 0.5, 0.5, rates)


def outlook(
    p50: float | None = None, status: Status = "ok", slope: tuple[float, float] | None = None, t_ns: int = 0
) -> Outlook:
    passages = np.array([0.8, 1.0, 1.2]) * (p50 or np.inf)
    made = Forecast(status, *(None if p50 is None else p for p in passages[[0, 1, 2]]), passages=passages)
    return Outlook("k1", "N/m", t_ns, 24.0, 0.1, 25.0, 5.0, made, None if slope is None else change(*slope))


def kinds(changes: list[AlarmTransition]) -> list[tuple[str, str]]:
    return [(step.kind, step.to_state) for step in changes]


def test_forecast_nearer_than_within_raises_and_tells_when() -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    assert alarms.step(outlook(40.0)) == []
    (raised,) = alarms.step(outlook(20.0, t_ns=7))
    assert (raised.kind, raised.parameter, raised.from_state, raised.to_state) == (
        "forecast",
        "k1",
        "NORM",
        "UNACK",
    )
    assert (raised.t_ns, raised.priority, raised.cause) == (7, "high", "raise")
    assert (raised.delta, raised.sd, raised.limit_value, raised.probability) == (-1.0, 0.1, 5.0, 1.0)
    assert (
        raised.message
        == "k1 reaches its limit 5 N/m in 20 days (80 %: 16 days … 24 days; alarm within 30 days)"
    )
    assert alarms.step(outlook(10.0)) == []


def test_forecast_alarm_clears_a_tenth_farther_and_not_before() -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    alarms.step(outlook(20.0))
    assert alarms.step(outlook(32.0)) == []
    (cleared,) = alarms.step(outlook(34.0))
    assert (cleared.from_state, cleared.to_state, cleared.cause) == ("UNACK", "RTNUN", "clear")
    assert kinds(alarms.step(outlook(20.0))) == [("forecast", "UNACK")]


@pytest.mark.parametrize("status", ["too short", "crossed"])
def test_history_that_says_nothing_neither_raises_nor_clears(status: Status) -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    assert alarms.step(outlook(None, status)) == []
    alarms.step(outlook(20.0))
    assert alarms.step(outlook(None, status)) == []


@pytest.mark.parametrize("status", ["no trend", "beyond"])
def test_limit_that_nothing_leads_to_any_more_clears(status: Status) -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    alarms.step(outlook(20.0))
    (cleared,) = alarms.step(outlook(None, status))
    assert (cleared.to_state, cleared.message) == ("RTNUN", "k1: nothing leads to its limit 5 N/m any more")


@pytest.mark.parametrize(("side", "slope", "raises"), [
    ("both", -1.0, True), ("low", -1.0, True), ("high", -1.0, False), ("both", 1.0, True),
    ("low", 1.0, False),
    ("both", -0.55, False), ("both", -0.2, False),
])  # fmt: skip
def test_rate_raises_where_its_interval_is_beyond_on_the_side_asked_for(
    side: str, slope: float, raises: bool
) -> None:
    alarms = PrognosisAlarms("press", [Rule(kinds=("rate",), side=side)])
    assert kinds(alarms.step(outlook(10.0, slope=(slope, 0.1)))) == ([("rate", "UNACK")] if raises else [])


def test_rate_alarm_clears_when_it_is_surely_a_tenth_slower() -> None:
    alarms = PrognosisAlarms("press", [Rule(within=None, kinds=("rate",))])
    (raised,) = alarms.step(outlook(slope=(-1.0, 0.1)))
    assert (raised.delta, raised.sd, raised.limit_value) == (-1.0, 0.1, 0.5)
    assert raised.message == "k1 falls by 1.00 ± 0.10 N/m a day (limit 0.5)"
    assert alarms.step(outlook(slope=(-0.45, 0.1))) == []
    assert alarms.step(outlook()) == []
    (cleared,) = alarms.step(outlook(slope=(-0.1, 0.1)))
    assert cleared.to_state == "RTNUN"
    assert "is slow again" in cleared.message


def test_alarms_that_the_run_before_left_standing_go_on() -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    alarms.restore([replace(Standing(), state="ACKED"), Standing(kind="level"), Standing(parameter="k9")])
    assert dict(alarms.states) == {("forecast", "k1"): "ACKED", ("rate", "k1"): "NORM"}
    (cleared,) = alarms.step(outlook(60.0))
    assert (cleared.from_state, cleared.to_state) == ("ACKED", "NORM")


@dataclass(frozen=True)
class Standing:
    kind: str = "forecast"
    parameter: str = "k1"
    state: str = "UNACK"


def test_other_parameters_touch_no_alarm() -> None:
    alarms = PrognosisAlarms("press", [Rule()])
    assert alarms.step(replace(outlook(1.0, slope=(-9.0, 0.1)), parameter="k2")) == []
