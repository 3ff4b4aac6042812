"""Which record an alarm is explained from."""

from typing import Any

from agent.evaluation.explain.explain import _record


def row(number: int, alarm_id: int, first: int, last: int) -> dict[str, Any]:
    return {"id": number, "run_id": 1, "alarm_id": alarm_id, "from_ns": first, "to_ns": last}


def test_alarm_that_began_no_record_is_explained_from_the_one_with_most_before_it() -> None:
    rows = [row(1, 5, 100, 900), row(2, 7, 400, 1200)]
    alarm = {"id": 6, "run_id": 1}
    assert _record(rows, alarm, 500) == rows[0]
    assert _record(rows, alarm, 1000) == rows[1]
    assert _record(rows, alarm | {"id": 7}, 500) == rows[1]
    assert _record(rows, alarm | {"run_id": 2}, 500) is None
