"""Status codes, values and instants by the status of a row; states of an alarm by Part 9's variables."""

from typing import Any

import pytest

from agent.cli.opcua.alarm_fields import states_of
from agent.cli.opcua.quality import own_code, quality_of

NOW = 1_800_000_000 * 10**9
ROW: dict[str, Any] = {
    "value": 25.5, "t_ns": NOW - 10**9, "status": "valid", "reason": None, "held": None, "held_age_s": None,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "value", "code", "own"),
    [
        ({}, 25.5, "Good", "Good"),
        ({"t_ns": NOW - 40 * 10**9}, 25.5, *["UncertainNoCommunicationLastUsableValue"] * 2),
        ({"status": "unexcited"}, 25.5, "UncertainSubNormal", "UncertainSubNormal"),
        ({"status": "unexcited", "held": 24.0, "held_age_s": 2.0}, 24.0, "UncertainLastUsableValue",
         "UncertainSubNormal"),
        ({"status": "invalid", "reason": "stuck", "held": 24.0, "held_age_s": 2.0, "value": None}, 24.0,
         "UncertainLastUsableValue", "BadSensorFailure"),
        ({"status": "invalid", "reason": "no data", "value": None}, None,
         "BadNoCommunication", "BadNoCommunication"),
        ({"status": "invalid", "reason": "mismatch", "value": None}, None, "Bad", "Bad"),
        ({"status": "warming", "value": None}, None, *["BadWaitingForInitialData"] * 2),
    ],
)  # fmt: skip
def test_row_is_worth_what_its_status_says(
    change: dict[str, Any], value: float | None, code: str, own: str
) -> None:
    row = ROW | change
    found = quality_of(row, NOW)
    assert (found.value, found.code, own_code(row, NOW)) == (value, code, own)
    assert found.t_ns == row["t_ns"] - (2 * 10**9 if row["held"] else 0)


@pytest.mark.parametrize(
    ("state", "cleared_at", "acked_at", "true"),
    [
        ("NORM", "t", None, {"Acked", "Confirmed"}),
        ("UNACK", None, None, {"Active"}),
        ("ACKED", None, "t", {"Active", "Acked", "Confirmed"}),
        ("RTNUN", "t", None, set()),
        ("SHLVD", None, None, {"Active", "Shelved"}),
        ("SHLVD", "t", "t", {"Acked", "Confirmed", "Shelved"}),
        ("DSUPR", None, None, {"Active", "Suppressed"}),
        ("OOSRV", None, "t", {"Active", "Acked", "Confirmed", "OutOfService"}),
    ],
)
def test_state_is_said_in_variables_of_part_9(
    state: str, cleared_at: str | None, acked_at: str | None, true: set[str]
) -> None:
    found = states_of({"state": state, "cleared_at": cleared_at, "acked_at": acked_at})
    assert {name for name, value in found.items() if value} == true
