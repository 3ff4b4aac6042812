"""Alarms that were acknowledged and are not over ask again."""

from dataclasses import dataclass

from agent.alarms.life_cycle import Alarm
from agent.blocks.advisory.alarm_states import ReAlarms

S = 10**9


@dataclass
class Rule:
    parameter: str = "k1"
    re_alarm_s: float | None = 60.0
    priority: str = "high"
    advice: str | None = "check the hub bolts"


def test_acknowledged_alarm_asks_again_after_its_time_and_only_while_it_stands() -> None:
    again = ReAlarms("press-7", [Rule(), Rule("k2", None)])
    acked = [("level", name, Alarm("ACKED", True)) for name in ("k1", "k2")]
    assert again.step(acked, 0, 0) == []  # type: ignore[arg-type]
    assert again.step(acked, 59 * S, 0) == []  # type: ignore[arg-type]
    (asks,) = again.step(acked, 60 * S, 7)  # type: ignore[arg-type]
    assert (asks.parameter, asks.from_state, asks.to_state, asks.cause, asks.t_ns) == (
        "k1", "ACKED", "UNACK", "re-alarm", 7,
    )  # fmt: skip
    assert asks.message == "k1: acknowledged 60 s ago and not over"


def test_time_begins_anew_with_each_acknowledgement() -> None:
    again = ReAlarms("press-7", [Rule()])
    again.step([("level", "k1", Alarm("ACKED", True))], 0, 0)
    again.step([("level", "k1", Alarm("NORM", False))], 30 * S, 0)
    assert again.step([("level", "k1", Alarm("ACKED", True))], 70 * S, 0) == []
