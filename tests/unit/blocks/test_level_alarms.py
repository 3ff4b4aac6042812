"""Level alarms: the table of series in alarm_series.toml, and what must hold for every series."""

import itertools
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agent.blocks.level_alarms import LevelAlarms
from agent.types import AlarmTransition, EstimateBatch, Reason, Status

CASES = tomllib.loads(Path(__file__).with_name("alarm_series.toml").read_text(encoding="utf-8"))["case"]
HOP, FIRST, RATE = 50, 249, 1000.0


@dataclass(frozen=True)
class Rule:
    parameter: str = "k1"
    limit: float | None = 15.0
    limit_percent: float | None = None
    side: str = "both"
    confidence: float = 0.95
    deadband: float | None = None
    on_delay_s: float | None = 0.0
    off_delay_s: float | None = None
    priority: str = "high"
    advice: str | None = None


def batch(
    values: Any, status: Any = Status.VALID, sd: Any = 1.0, start: int = 0, **more: Any
) -> EstimateBatch:
    """Make rows from values (N,) or (N, q); start is the number of the first row."""
    value = np.atleast_2d(np.asarray(values, dtype=float).T).T
    shape, rows = value.shape, np.arange(start, start + len(value))
    status = np.broadcast_to(np.asarray(status, dtype=np.uint8).reshape(-1, 1), shape)
    nothing = np.full(shape, np.nan)
    fields: dict[str, Any] = {
        "rig": "press", "method": "window-ml",
        "parameters": ("k1", "k2", "B1")[: shape[1]], "units": ("N/m",) * shape[1],
        "reference": np.full(shape[1], 25.0), "baseline_id": None, "index": FIRST + HOP * rows,
        "t_ns": (FIRST + HOP * rows) * 1_000_000, "value": value,
        "sd": np.broadcast_to(np.asarray(sd, float), shape),
        "lower": nothing, "upper": nothing,
        "sd_repeat": np.broadcast_to(np.asarray(sd, float), shape), "status": status,
        "reason": np.full(shape, Reason.NONE, np.uint8),
        "held": nothing, "held_age_s": nothing, "window_s": np.full(shape, 0.25),
        "n_used": np.full(len(value), 250), "n_missing": np.zeros(len(value), int),
        "dof": np.full(len(value), np.inf),
    }  # fmt: skip
    return EstimateBatch(**(fields | more))


def parse_rows(text: str) -> tuple[list[float], list[Status]]:
    codes = {"?": Status.UNEXCITED, "!": Status.INVALID}
    values: list[float] = []
    status: list[Status] = []
    for token in text.split():
        what, count = token.split("x")
        values += [99.0 if what in codes else float(what)] * int(count)
        status += [codes.get(what, Status.VALID)] * int(count)
    return values, status


def case_rule(case: dict[str, Any]) -> Rule:
    special = {"none": None, "default": None}
    return replace(Rule(), **{key: special.get(v, v) for key, v in case.get("rule", {}).items()})


def case_batch(case: dict[str, Any]) -> EstimateBatch:
    values, status = parse_rows(case["rows"])
    n = len(values)
    return batch(
        values,
        status,
        sd=case.get("sd", 1.0),
        reference=np.array([case.get("reference", 25.0)]),
        window_s=np.full((n, 1), case.get("window_s", 0.25)),
        dof=np.full(n, case.get("dof", np.inf)),
    )


def pieces(whole: EstimateBatch, cuts: list[int]) -> list[EstimateBatch]:
    fixed = {"parameters", "units", "reference"}
    names = [name for name in EstimateBatch.__dataclass_fields__ if name not in fixed]
    per_row = [name for name in names if np.ndim(getattr(whole, name))]
    edges = [0, *sorted(cuts), len(whole)]
    return [
        replace(whole, **{name: getattr(whole, name)[a:b] for name in per_row})
        for a, b in itertools.pairwise(edges)
    ]


def written(transitions: list[AlarmTransition]) -> list[str]:
    return [f"{(t.t_ns // 1_000_000 - FIRST) // HOP} {t.from_state}>{t.to_state}" for t in transitions]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_level_alarms_series_gives_the_expected_transitions(case: dict[str, Any]) -> None:
    assert written(LevelAlarms("press", [case_rule(case)], RATE).step(case_batch(case))) == case["expect"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_level_alarms_series_row_by_row_gives_the_same(case: dict[str, Any]) -> None:
    alarms, whole = LevelAlarms("press", [case_rule(case)], RATE), case_batch(case)
    found = [step for piece in pieces(whole, list(range(1, len(whole)))) for step in alarms.step(piece)]
    assert written(found) == case["expect"]


VALUES = st.sampled_from([5.0, 25.0, 36.9, 38.0, 41.0, 42.0, 60.0])
SERIES = st.lists(
    st.tuples(VALUES, st.sampled_from(list(Status)), st.integers(1, 6)),
    min_size=1,
    max_size=25,
)


@given(SERIES, st.lists(st.integers(0, 120), max_size=8), st.floats(0, 0.4), st.floats(0, 0.4))
def test_level_alarms_batch_cut_anywhere_gives_identical_transitions(
    series: list[tuple[float, Status, int]], cuts: list[int], on: float, off: float
) -> None:
    values = [value for value, _, count in series for _ in range(count)]
    status = [code for _, code, count in series for _ in range(count)]
    whole = batch(values, status)
    rule = Rule(on_delay_s=on, off_delay_s=off)
    at_once = LevelAlarms("press", [rule], RATE).step(whole)
    alarms = LevelAlarms("press", [rule], RATE)
    in_pieces = [
        t for piece in pieces(whole, [c for c in cuts if c <= len(values)]) for t in alarms.step(piece)
    ]
    assert in_pieces == at_once
    assert at_once == plain_transitions(values, status, on, off)


def plain_transitions(values: list[float], status: list[Status], on: float, off: float) -> list[Any]:
    """The rule as one would tell it, row by row with a normal distribution; compared by what it prints."""
    alarms = LevelAlarms("press", [Rule(on_delay_s=on, off_delay_s=off)], RATE)
    found, up, down, before, stands = [], None, None, None, False
    for row, (value, code) in enumerate(zip(values, status, strict=True)):
        if code != Status.VALID:
            before = None
            continue
        margin = abs(value - 25.0)
        over, within = margin - 15.0 >= 1.6448537, 13.5 - margin >= 1.6448537
        hop = 0.05 if before == row - 1 else 0.0
        up = None if not over else 0.0 if up is None else up + hop
        down = None if not within else 0.0 if down is None else down + hop
        before = row
        if not stands and up is not None and up >= max(on, 0.125) - 1e-6:
            stands = True
            found.append(row)
        elif stands and down is not None and down >= off - 1e-6:
            stands = False
            found.append(row)
    expected = alarms.step(batch(values, status))
    assert [(t.t_ns // 1_000_000 - FIRST) // HOP for t in expected] == found
    return expected


def test_level_alarms_chatter_on_the_limit_is_at_most_one_activation(rng: np.random.Generator) -> None:
    noise = rng.normal(
        40.0, 1.0, 72_000
    )  # one hour of rows; the estimate sits on the limit with its own noise
    found = LevelAlarms("press", [Rule(on_delay_s=0.2, off_delay_s=2.0)], RATE).step(batch(noise))
    assert sum(t.to_state == "UNACK" for t in found) <= 1


def test_level_alarms_silence_between_segments_does_not_count() -> None:
    alarms = LevelAlarms("press", [Rule(on_delay_s=0.2)], RATE)
    assert alarms.step(batch([45.0, 45.0])) == []
    assert alarms.step(batch([99.0], Status.WARMING, start=4000)) == []
    assert written(alarms.step(batch([45.0] * 5, start=4001))) == ["4004 NORM>UNACK"]


def test_level_alarms_wall_clock_step_changes_no_timer() -> None:
    stepped = batch([45.0] * 6)
    stepped.t_ns[2:] += 3_600_000_000_000
    found = LevelAlarms("press", [Rule(on_delay_s=0.2)], RATE).step(stepped)
    assert [t.t_ns for t in found] == [stepped.t_ns[4]]


def test_level_alarms_several_parameters_come_in_order_of_time() -> None:
    values = np.full((20, 3), 25.0)
    values[4:, 1] = 45.0
    values[2:, 2] = 5.0
    rules = [Rule("k2"), Rule("B1", priority="low")]
    found = LevelAlarms("press", rules, RATE).step(batch(values))
    assert [(t.parameter, t.priority) for t in found] == [("B1", "low"), ("k2", "high")]


def test_level_alarms_raised_carries_figures_and_a_sentence() -> None:
    (raised,) = LevelAlarms("press", [Rule()], RATE).step(batch([50.1] * 5, sd=0.9))
    assert raised.message == "k1 is 25.1 ± 0.9 N/m above nominal 25 (limit 15)"
    assert (raised.rig, raised.kind, raised.cause) == ("press", "level", "raise")
    assert raised.delta == pytest.approx(25.1)
    assert (raised.sd, raised.limit_value) == (0.9, 15.0)
    assert raised.probability == pytest.approx(1.0)


def test_level_alarms_cleared_says_so_with_the_baseline_it_was_judged_by() -> None:
    _, cleared = LevelAlarms("press", [Rule()], RATE).step(
        batch([50.0] * 5 + [21.8], sd=0.12, baseline_id=(7,))
    )
    assert cleared.message == "k1 is back within its limit: 3.20 ± 0.12 N/m below its baseline 25 (limit 15)"
    assert (cleared.cause, cleared.limit_value, cleared.probability) == ("clear", 15.0, pytest.approx(1.0))


def test_level_alarms_probability_is_that_of_students_t() -> None:
    (raised,) = LevelAlarms("press", [Rule(confidence=0.9)], RATE).step(
        batch([42.0] * 5, dof=np.full(5, 5.0))
    )
    assert raised.probability == pytest.approx(
        0.94903, abs=1e-5
    )  # t = 2, five degrees of freedom: table value


def test_level_alarms_restored_as_acknowledged_and_cleared_is_normal() -> None:
    alarms = LevelAlarms("press", [Rule()], RATE)
    alarms.restore({"k1": "ACKED"})
    assert written(alarms.step(batch([25.0] * 2, start=6))) == ["6 ACKED>NORM"]


def test_level_alarms_carry_advice_and_the_change_in_per_cent() -> None:
    (raised,) = LevelAlarms("press", [Rule(advice="check the hub bolts")], RATE).step(batch([45.0] * 6))
    assert (raised.advice, raised.percent) == ("check the hub bolts", pytest.approx(80.0))


def test_level_alarms_restored_from_other_rules_are_normal() -> None:
    alarms = LevelAlarms("press", [Rule("k2")], RATE)
    alarms.restore({"k1": "UNACK"})
    assert alarms.states == {"k2": "NORM"}


def test_level_alarms_restored_from_states_alone_clear_as_usual() -> None:
    alarms = LevelAlarms("press", [Rule(off_delay_s=0.1)], RATE)
    alarms.restore({"k1": "ACKED"})
    assert written(alarms.step(batch([25.0] * 5))) == ["2 ACKED>NORM"]


def test_level_alarms_without_rules_or_rows_says_nothing() -> None:
    assert LevelAlarms("press", [], RATE).step(batch([45.0] * 6)) == []
    assert LevelAlarms("press", [Rule()], RATE).step(batch(np.empty((0, 1)))) == []


def test_level_alarms_nan_marked_valid_is_not_judged() -> None:
    alarms = LevelAlarms("press", [Rule()], RATE)
    assert written(alarms.step(batch([45.0] * 4 + [np.nan] * 20))) == ["3 NORM>UNACK"]


@pytest.mark.parametrize(
    ("rule", "word"),
    [
        (Rule(limit=None), "exactly one"),
        (Rule(limit_percent=5.0), "exactly one"),
        (Rule(confidence=0.49), "confidence"),
        (Rule(confidence=1.0), "confidence"),
    ],
)
def test_level_alarms_rule_that_cannot_be_judged_is_refused(rule: Rule, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        LevelAlarms("press", [rule], RATE)


def test_level_alarms_parameter_that_is_not_estimated_is_refused() -> None:
    with pytest.raises(ValueError, match="k9"):
        LevelAlarms("press", [Rule("k9")], RATE).step(batch([25.0]))


def test_level_rule_takes_any_object_with_the_keys_as_attributes() -> None:
    rule = SimpleNamespace(**{name: getattr(Rule(), name) for name in Rule.__dataclass_fields__})
    assert len(LevelAlarms("press", [rule], RATE).step(batch([45.0] * 6))) == 1


def test_change_from_a_learnt_reference_is_known_as_well_as_two_estimates_of_one_rig_differ() -> None:
    # the masses may be off by 20: against nominal nothing can be said, against the same rig's past it can
    known = {"sd_repeat": np.full((5, 1), 0.3), "baseline_id": (3,), "reference_sd": (0.4,)}
    assert LevelAlarms("press", [Rule()], RATE).step(batch([45.0] * 5, sd=20.0)) == []
    (raised,) = LevelAlarms("press", [Rule()], RATE).step(batch([45.0] * 5, sd=20.0, **known))
    assert (raised.delta, raised.sd) == (20.0, pytest.approx(0.5))
    half = known | {"baseline_id": (None,), "reference_sd": (float("nan"),)}
    assert LevelAlarms("press", [Rule()], RATE).step(batch([45.0] * 5, sd=20.0, **half)) == []
