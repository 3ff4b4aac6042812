"""Alarms that stand are silent while the machine rests, where the configuration says so."""

from dataclasses import dataclass
from typing import Literal

import pytest

from agent.alarms.life_cycle import Alarm
from agent.blocks.advisory.alarm_states import AlarmStates
from agent.blocks.advisory.rest import RestAlarms
from agent.types import AlarmTransition, Status
from tests.storage.rows import START, step
from tests.unit.blocks.test_blind_alarms import INVALID, RATE, UNEXCITED, VALID, rows


@dataclass
class Rule:
    parameter: str = "k1"
    at_rest: Literal["hold", "suppress"] = "suppress"
    priority: str = "high"


def causes(found: list[AlarmTransition]) -> list[str]:
    return [change.cause for change in found]


@pytest.mark.parametrize("cut", [1.0, 13.0])
def test_rest_silences_after_ten_seconds_and_the_first_valid_row_ends_it(cut: float) -> None:
    rest = RestAlarms("press-7", [Rule()], RATE)
    assert rest.step(rows(0, 5.0, VALID)) == []
    pieces = (rows(100 + round(n * cut * 20), cut, UNEXCITED) for n in range(round(13 / cut)))
    found = [change for piece in pieces for change in rest.step(piece)]
    assert [(change.cause, change.t_ns - START) for change in found] == [
        ("suppress", round((5.0 + 9.95) * 1e9))
    ]
    assert causes(rest.step(rows(360, 1.0, INVALID))) == []
    assert causes(rest.step(rows(380, 1.0, VALID))) == ["unsuppress"]


def test_rest_is_held_by_default() -> None:
    rest = RestAlarms("press-7", [Rule(at_rest="hold")], RATE)
    assert rest.step(rows(0, 60.0, Status.UNEXCITED)) == []


def test_only_what_stands_is_silenced_and_speaks_again() -> None:
    states = AlarmStates()
    silence, speak = step("UNACK", "DSUPR", cause="suppress"), step("DSUPR", "UNACK", cause="unsuppress")
    assert states.step([silence, speak]) == []
    states.step([step("NORM", "UNACK")])
    states.take_up(step("UNACK", "ACKED"), "acknowledge")
    (silent,) = states.step([silence])
    (asks,) = states.step([speak])
    assert isinstance(silent, AlarmTransition)
    assert isinstance(asks, AlarmTransition)
    assert [(silent.from_state, silent.to_state), (asks.from_state, asks.to_state)] == [
        ("ACKED", "DSUPR"), ("DSUPR", "UNACK"),
    ]  # fmt: skip
    assert states["level", "k1"] == Alarm("UNACK", True)
