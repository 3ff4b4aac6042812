"""`deltak limits`: limits and delays that the learnt spread allows, and what configured ones would cost."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.covariates.compensation import dependences
from agent.commissioning.baseline.target import Target, configured, target_of
from agent.commissioning.tuning import LITTLE_HOURS, ORDINARY, PER_YEAR, RESOLVE
from agent.config import Alarm, RigConfig
from agent.errors import Fault, StoreError, UsageError
from agent.records import Baseline
from agent.reference.limits import Healthy, false_per_year, proposed
from agent.storage.read import baselines, queries
from agent.text import number

RECENT = ("10m", "1d", None)
"""How far back rows are looked at for their sd and window: no farther than there are some."""


def limits(
    place: Path, rig: str | None, per_year: float = PER_YEAR, config: Path | None = None
) -> dict[str, Any]:
    """Return the document of CONTRACT section 8: a limit and an on-delay for each parameter with a baseline.

    config: of the rig, beside a database.
    Raises UsageError where there is none, or no recent row; ConfigError, StoreError.
    """
    if not per_year > 0:
        raise UsageError.at(
            "--per-year", f"{per_year:g} is no number of alarms", "give a number above 0, such as 1"
        )
    target = target_of(place, rig) if config is None else configured(place, config)
    target.graph()
    found = baselines.standing(target.db, target.rig)
    if not found:
        advice = f"learn one from a healthy time first: deltak baseline learn {place}"
        raise UsageError.at(
            target.db, f"{target.rig} has no baseline, and so no spread to set limits by", advice
        )
    rows = {one.parameter: _row(target, one, per_year) for one in found}
    return {
        "rig": target.rig,
        "db": str(target.db),
        "per_year": per_year,
        "parameters": rows,
        "written": None,
    }


def _row(target: Target, one: Baseline, per_year: float) -> dict[str, Any]:
    healthy = healthy_of(target, one)
    if healthy is None:
        what = f"{one.parameter} has no valid row, and so no sd of a window"
        raise UsageError.at(target.db, what, "let the agent run while the machine moves")
    confidence = _confidence(target.config, one.parameter)
    found = proposed(healthy, per_year, confidence)
    limit, delay_s = _rounded(found.limit), _rounded(found.on_delay_s)
    row: dict[str, Any] = {
        "limit": limit, "on_delay_s": delay_s,
        "false_per_year": false_per_year(healthy, limit, delay_s, confidence),
        "finds": _rounded(found.finds), "finds_within_s": _rounded(found.finds_within_s), "unit": one.unit,
        "reference": one.reference, "baseline_id": one.baseline_id, "spread_sd": one.spread_sd,
        "row_sd": healthy.row_sd, "n_effective": one.n_effective,
        "compensated": [dependence.name for dependence in dependences(one)],
    }  # fmt: skip
    return row | {"words": _words(one, healthy, row)}


def _rounded(value: float) -> float:
    """Return a number to three digits, no smaller: more are not known, and a limit may not shrink."""
    if not 0.0 < value < np.inf:
        return value
    step = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.ceil(value / step - 1e-9) * step:.3g}")


def _words(one: Baseline, healthy: Healthy, row: Mapping[str, Any]) -> str:
    said = (
        f"finds a change of {number(row['finds'], 3)} {one.unit} within {number(row['finds_within_s'], 3)} s"
    )
    if one.n_effective < LITTLE_HOURS:
        said += f"; rests on {number(one.n_effective, 2)} independent hours: learn longer for a smaller limit"
    elif row["limit"] <= 1.02 * healthy.least:
        said += "; a longer window would allow a smaller limit"
    return said


def healthy_of(target: Target, one: Baseline) -> Healthy | None:
    """Return how a parameter moves while healthy, its rows' sd by the newest; None without a valid row."""
    for since in RECENT:
        rows = queries.estimates(target.db, target.rig, one.parameter, since)
        valid = [
            row for row in rows if row["status"] == "valid" and row["span_s"] == 0 and row["sd"] is not None
        ]
        if valid:
            return _healthy(target.config, one, valid)
    return None


def _healthy(config: RigConfig | None, one: Baseline, rows: Sequence[Mapping[str, Any]]) -> Healthy:
    repeat, window = (np.array([row[name] for row in rows]) for name in ("sd_repeat", "window_s"))
    steps = np.diff([row["t_ns"] for row in rows]) / 1e9
    window_s = float(np.median(window))
    ahead = steps[steps > 0]
    hop_s = float(ahead.min()) if len(ahead) else window_s
    resolve = RESOLVE
    if config is not None:
        hop_s, resolve = config.estimator.hop_s, config.estimator.resolve
    moved = [d.sd * d.spread for d in dependences(one)]
    row_sd = float(np.linalg.norm([np.median(repeat), one.sd, *moved]))
    least = float(np.quantile(repeat, ORDINARY)) / resolve
    return Healthy(
        one.spread_sd,
        one.correlation_s,
        one.n_effective,
        row_sd,
        one.within_sd,
        window_s,
        min(hop_s, window_s),
        least,
    )


def _confidence(config: RigConfig | None, parameter: str) -> float:
    known = {alarm.parameter: alarm.confidence for alarm in config.limits} if config is not None else {}
    return known.get(parameter, 0.95)


def limit_warnings(config: RigConfig) -> Iterator[Fault]:
    """Warn of limits a healthy machine would cross more than once a year, if its store has a baseline."""
    target = Target(config.store.path, config.rig.name, config)
    try:
        known = (
            {one.parameter: one for one in baselines.standing(target.db, target.rig)}
            if target.db.exists()
            else {}
        )
    except (StoreError, OSError) as error:
        yield Fault("store.path", f"its baselines cannot be read ({error})", "see deltak db check")
        return
    for i, alarm in enumerate(config.alarm):
        one = known.get(alarm.parameter)
        if one is not None and alarm in config.limits:
            yield from _crossed(target, one, alarm, f"alarm[{i}]")


def _crossed(target: Target, one: Baseline, alarm: Alarm, path: str) -> Iterator[Fault]:
    healthy = healthy_of(target, one)
    if healthy is None:
        return
    key = "limit" if alarm.limit is not None else "limit_percent"
    limit = alarm.limit or abs(one.reference) * (alarm.limit_percent or 0.0) / 100.0
    delay = healthy.window_s if alarm.on_delay_s is None else max(alarm.on_delay_s, 0.5 * healthy.window_s)
    often = false_per_year(healthy, limit, delay, alarm.confidence)
    if often <= PER_YEAR * 1.01:
        return
    better = proposed(healthy, PER_YEAR, alarm.confidence)
    what = (
        f"{number(limit, 3)} {one.unit} may be crossed {number(often, 2)} times a year by the healthy machine"
    )
    allowed = f"{number(_rounded(better.limit), 3)} with an on-delay of {number(better.on_delay_s, 3)} s"
    advice = f"{allowed} is crossed once at the most; deltak limits says more"
    yield Fault(f"{path}.{key}", what, advice)
