"""`deltak limits --try`: the stored history decided once more under the limits of another file.

The same alarm block as the pipeline's goes over the rows that are kept, which is every one around an alarm
and one a `store.every_s` elsewhere; aggregates raise nothing. Changes are counted from the baseline where one
stands.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby, islice
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.level_alarms import LevelAlarms
from agent.blocks.rig_model import estimated
from agent.commissioning.baseline.target import target_of
from agent.commissioning.tuning import NEAR_NS, ROWS_TRIED
from agent.config import Alarm, RigConfig, load
from agent.errors import UsageError
from agent.records import Baseline
from agent.storage.read import baselines, queries
from agent.text import iso_time
from agent.types import AlarmTransition, EstimateBatch, FloatArray, Status

Row = Mapping[str, Any]
_STATUS = {status.name.lower(): int(status) for status in Status}


def tried(place: Path, rig: str | None, file: Path, since: str | None, until: str | None) -> dict[str, Any]:
    """Return which alarms the limits of a file would have raised, beside those that were.

    Raises UsageError where the file has none, or its rig, parameters or units are not those of the rows.
    """
    config = load(file)
    target = target_of(place, rig)
    rules = list(config.limits)
    there = queries.parameters(target.db, target.rig)
    unknown = [rule.parameter for rule in rules if rule.parameter not in there]
    rules = [rule for rule in rules if rule.parameter in there]
    if not rules:
        what = "has no [[alarm]] on a parameter that the database has rows of"
        raise UsageError.at(file, what, f"there are rows of {', '.join(there) or 'none'}")
    known = {one.parameter: one for one in baselines.standing(target.db, target.rig)}
    would: list[dict[str, Any]] = []
    rows = 0
    for rule in rules:
        asked = target.db, target.rig, rule.parameter, since, until
        _check_unit(config, rule, queries.newest_estimates(*asked, 1))
        history = queries.each_estimate(*asked)
        full = (row for row in history if row["span_s"] == 0 and row["window_s"] is not None)
        alarms = LevelAlarms(config.rig.name, [rule], config.rig.sample_rate_hz)
        steps: list[AlarmTransition] = []
        for part in _batches(config, rule, full, known.get(rule.parameter)):
            rows += len(part.index)
            steps += alarms.step(part)
        would += _activations(steps)
    were = [row for row in queries.alarms(target.db, target.rig) if row["kind"] == "level"]
    stored = [_stored(row) for row in were]
    return {
        "rig": target.rig, "tried": str(file), "rows": rows, "would": would, "were": stored,
        "more": _without(would, stored), "fewer": _without(stored, would), "without_rows": unknown,
        "counted_from_baseline": sorted(
            name for name in known if any(rule.parameter == name for rule in rules)
        ),
    }  # fmt: skip


def _check_unit(config: RigConfig, rule: Alarm, rows: Sequence[Row]) -> None:
    unit = config.parameters[rule.parameter].unit if rule.parameter in estimated(config) else ""
    if rows and rows[-1]["unit"] != unit:
        what = f"{rule.parameter} is in {unit or 'nothing'} there, in {rows[-1]['unit']} in the store"
        raise UsageError.at(config.file, what, "try the limits of a configuration of the same machine")


def _batches(
    config: RigConfig, rule: Alarm, rows: Iterable[Row], baseline: Baseline | None
) -> Iterator[EstimateBatch]:
    """Give rows in order of time as the alarm takes them, few at a time."""

    def header(row: Row) -> tuple[Any, ...]:
        return row["run_id"], row["method"], row["unit"], row["reference"]

    for key, part in groupby(rows, key=header):
        while some := list(islice(part, ROWS_TRIED)):
            yield _batch(some, key, config, rule, baseline)


def _batch(
    rows: Sequence[Row], header: tuple[Any, ...], config: RigConfig, rule: Alarm, baseline: Baseline | None
) -> EstimateBatch:
    _, method, unit, reference = header
    figures = ("value", "sd", "lower", "upper", "sd_repeat", "window_s", "held", "held_age_s")
    columns: dict[str, Any] = {name: _column(rows, name) for name in figures}
    t_ns = np.array([row["t_ns"] for row in rows], dtype=np.int64)
    origin = np.nan if reference is None else float(reference)
    return EstimateBatch(
        rig=config.rig.name, method=method, parameters=(rule.parameter,), units=(unit,),
        reference=np.array([origin if baseline is None else baseline.reference]),
        baseline_id=None if baseline is None else (baseline.baseline_id,),
        reference_sd=None if baseline is None else (baseline.sd,),
        index=np.rint(t_ns * (config.rig.sample_rate_hz / 1e9)).astype(np.int64), t_ns=t_ns,
        status=np.array([[_STATUS[row["status"]]] for row in rows], dtype=np.uint8),
        reason=np.zeros((len(rows), 1), dtype=np.uint8),
        n_used=np.array([row["n_used"] for row in rows], dtype=np.int64),
        n_missing=np.array([row["n_missing"] for row in rows], dtype=np.int64),
        dof=_dof(columns["upper"] - columns["value"], columns["sd"]), **columns,
    )  # fmt: skip


def _column(rows: Sequence[Row], name: str) -> FloatArray:
    """Return a figure of each row (N, 1), NaN where it has none."""
    return np.array([[np.nan if row[name] is None else row[name]] for row in rows], dtype=np.float64)


def _dof(half: FloatArray, sd: FloatArray) -> FloatArray:
    """Return the degrees of freedom (N,) of Student's t that an interval of half that width belongs to."""
    from scipy.special import stdtrit

    table = np.r_[np.geomspace(1.0, 1000.0, 400), 1e9]
    quantile = np.asarray(stdtrit(table, 0.975), dtype=np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.asarray(half / sd).ravel()
    return np.asarray(np.interp(ratio, quantile[::-1], table[::-1]))


def _activations(steps: Iterable[AlarmTransition]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    for step in steps:
        if step.to_state == "UNACK":
            found.append(
                {
                    "parameter": step.parameter, "raised_ns": step.t_ns, "raised_at": iso_time(step.t_ns),
                    "cleared_ns": None, "cleared_at": None, "delta": step.delta,
                    "limit_value": step.limit_value,
                    "message": step.message,
                }
            )  # fmt: skip
        elif step.cause == "clear":
            found[-1] |= {"cleared_ns": step.t_ns, "cleared_at": iso_time(step.t_ns)}
    return found


def _stored(row: Row) -> dict[str, Any]:
    from agent.storage.read.times import parse_time

    ends = [None if row[key] is None else parse_time(row[key], None) for key in ("raised_at", "cleared_at")]
    kept = {
        key: row[key]
        for key in ("id", "parameter", "raised_at", "cleared_at", "delta", "limit_value", "message")
    }
    return kept | {"raised_ns": ends[0], "cleared_ns": ends[1]}


def _without(some: Sequence[Row], others: Sequence[Row]) -> list[Row]:
    """Return the activations of which none of the others is of the same event."""
    return [one for one in some if not any(_same_event(one, other) for other in others)]


def _same_event(one: Row, other: Row) -> bool:
    last = [2**62 if row["cleared_ns"] is None else row["cleared_ns"] for row in (one, other)]
    apart = max(one["raised_ns"] - last[1], other["raised_ns"] - last[0])
    return bool(one["parameter"] == other["parameter"] and apart <= NEAR_NS)
