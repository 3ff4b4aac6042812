"""Alarms of parameters that are not estimated: when they are due, what shares one, and what clears them."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from agent.blocks.advisory.blind_alarms import BlindAlarms
from agent.types import AlarmTransition, EstimateBatch, Reason, Status
from tests.storage.rows import batch

RATE, HOP = 1000.0, 50
VALID, UNEXCITED, INVALID, WARMING = Status.VALID, Status.UNEXCITED, Status.INVALID, Status.WARMING


@dataclass
class Rule:
    parameter: str = "k1"
    blind_s: float | None = None
    priority: str = "high"
    advice: str | None = None


def rows(
    first: int, seconds: float, status: Any, reason: Any = Reason.NONE, parameters: tuple[str, ...] = ("k1",)
) -> EstimateBatch:
    """Rows of so many seconds; status and reason one for all, or one a parameter."""
    count = round(seconds * RATE / HOP)
    shape = (count, len(parameters))
    return batch(
        count, first=first, parameters=parameters, status=np.broadcast_to(np.uint8(status), shape),
        reason=np.broadcast_to(np.uint8(reason), shape),
    )  # fmt: skip


def said(found: list[AlarmTransition]) -> list[tuple[str, str, str]]:
    return [(step.kind, step.parameter, step.to_state) for step in found]


def alarms(*rules: Rule) -> BlindAlarms:
    return BlindAlarms("press-7", rules or [Rule()], RATE, 0.25)


def test_parameter_that_is_never_estimated_is_blind_after_a_minute() -> None:
    watch = alarms()
    assert watch.step(rows(0, 60.0, INVALID, Reason.CHANGING)) == []
    (raised,) = watch.step(rows(1200, 1.0, INVALID, Reason.CHANGING))
    assert said([raised]) == [("blind", "k1", "UNACK")]
    assert raised.message == "no valid estimate of k1 for 60 s, most often for the reason changing"
    assert said(watch.step(rows(1220, 0.05, VALID))) == [("blind", "k1", "RTNUN")]


def test_time_is_a_hundred_windows_where_those_are_longer_than_a_minute() -> None:
    watch = alarms()
    long = rows(0, 99.0, INVALID, Reason.CHANGING)
    assert watch.step(batch(len(long), status=long.status, reason=long.reason, parameters=("k1",),
                            window_s=np.full(long.value.shape, 1.0))) == []  # fmt: skip


@pytest.mark.parametrize("cut", [1, 7, 400])
def test_cutting_rows_elsewhere_changes_nothing(cut: int) -> None:
    watch, found = alarms(Rule(blind_s=5.0)), []
    for first in range(0, 400, cut):
        count = min(cut, 400 - first)
        found += watch.step(rows(first, count * HOP / RATE, INVALID, Reason.DIVERGED))
    assert [(step.parameter, step.t_ns) for step in found] == [("k1", int(batch(101).t_ns[100]))]


@pytest.mark.parametrize("seed", range(5))
def test_rows_at_once_lead_to_what_they_lead_to_one_by_one(seed: int) -> None:
    """Two parameters, each valid and not in stretches, and windows of many lengths, unknown in some rows."""
    rng = np.random.default_rng(seed)
    odd = np.repeat(rng.random((60, 2)) < 0.6, 100, axis=0)
    one = batch(
        len(odd), parameters=("k1", "k2"), status=np.where(odd, INVALID, VALID).astype(np.uint8),
        reason=np.where(odd, Reason.CHANGING, Reason.NONE).astype(np.uint8),
        window_s=np.where(odd & (rng.random(odd.shape) < 0.5), np.nan, rng.uniform(0.01, 0.2, odd.shape)),
    )  # fmt: skip
    several, single = (alarms(Rule("k1"), Rule("k2", blind_s=7.0)) for _ in range(2))
    edges = [0, *sorted(rng.integers(0, len(odd), 9).tolist()), len(odd)]
    found = [step for ends in pairwise(edges) for step in several.step(one.part(slice(*ends)))]
    assert found == [step for row in range(len(odd)) for step in single.step(one.part(slice(row, row + 1)))]
    assert found


def test_fault_that_flickers_faster_than_a_window_is_not_silent() -> None:
    """Rows alternate between two reasons; the one that prevailed is named."""
    watch, found = alarms(Rule(blind_s=10.0)), []
    for first in range(0, 300, 3):
        found += watch.step(rows(first, 0.1, INVALID, Reason.CHANGING))
        found += watch.step(rows(first + 2, 0.05, WARMING))
    (raised,) = found
    assert "changing" in raised.message


def test_standstill_is_no_fault_unless_a_time_is_named() -> None:
    assert alarms().step(rows(0, 300.0, UNEXCITED, Reason.STANDSTILL)) == []
    (raised,) = alarms(Rule(blind_s=60.0)).step(rows(0, 61.0, UNEXCITED, Reason.STANDSTILL))
    assert raised.message.endswith("most often for the reason standstill")


def test_motion_that_resolves_nothing_for_a_minute_is_told() -> None:
    (raised,) = alarms().step(rows(0, 61.0, UNEXCITED))
    assert raised.message.endswith("most often for the reason unexcited")


def test_missing_samples_are_no_time_and_clear_nothing() -> None:
    watch = alarms()
    watch.step(rows(0, 30.0, INVALID, Reason.CHANGING))
    assert watch.step(rows(10**6, 1.0, WARMING)) == []
    assert said(watch.step(rows(10**6 + 20, 40.0, WARMING))) == [("blind", "k1", "UNACK")]
    assert watch.step(rows(2 * 10**6, 40.0, WARMING)) == []


def test_what_a_channels_alarm_explains_is_told_once() -> None:
    assert alarms().step(rows(0, 90.0, INVALID, Reason.STUCK), explained=True) == []
    assert said(alarms().step(rows(0, 90.0, INVALID, Reason.STUCK))) == [("blind", "k1", "UNACK")]
    assert said(alarms().step(rows(0, 90.0, INVALID, Reason.CHANGING), explained=True)) == [
        ("blind", "k1", "UNACK")
    ]


def test_parameters_that_are_blind_for_one_reason_share_one_alarm() -> None:
    names = ("k1", "k2", "B1")
    watch = alarms(*(Rule(name) for name in names))
    (raised,) = watch.step(rows(0, 61.0, INVALID, Reason.DIVERGED, names))
    assert "k1, k2 and B1" in raised.message
    assert watch.step(rows(1220, 5.0, (VALID, INVALID, INVALID), Reason.DIVERGED, names)) == []
    assert said(watch.step(rows(1320, 5.0, VALID, Reason.NONE, names))) == [("blind", "k1", "RTNUN")]


def test_model_that_explains_the_machine_no_more_is_one_alarm_of_its_own_kind() -> None:
    names = ("k1", "k2")
    watch = alarms(*(Rule(name) for name in names))
    found = watch.step(rows(0, 70.0, INVALID, Reason.MISMATCH, names))
    assert said(found) == [("mismatch", "model", "UNACK")]
    assert said(watch.step(rows(1400, 0.05, VALID, Reason.NONE, names))) == [("mismatch", "model", "RTNUN")]


def test_alarm_of_an_earlier_run_is_neither_raised_again_nor_forgotten() -> None:
    watch = alarms()
    watch.restore([("blind", "k1", "high"), ("blind", "gone", "high")])
    assert watch.step(rows(0, 90.0, INVALID, Reason.CHANGING)) == []
    assert said(watch.step(rows(1800, 0.05, VALID))) == [("blind", "k1", "RTNUN")]
