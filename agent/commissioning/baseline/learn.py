"""`deltak baseline learn`: references and their spread from the valid rows of a healthy stretch.

valid rows -> means of equal periods -> what covariates do is taken out -> robust reference, spread between
periods and days -> v_baselines. The periods are a 24th of what is wanted at least: hours, of a day.
"""

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.commissioning.baseline.covariates import Ready, depends, known_rows, read, same, taken_out, unready
from agent.commissioning.baseline.target import Target, target_of
from agent.commissioning.tuning import DOUBTFUL_PERIODS, LEAST_PERIODS
from agent.config.sections.covariates import BaselineTable
from agent.errors import Fault, UsageError
from agent.records import Baseline
from agent.reference.covariates.dependence import written
from agent.reference.spread import periods, spread
from agent.storage import maintenance
from agent.storage.read import queries
from agent.storage.read.points import Points, points_of
from agent.text import number, percent


@dataclass(frozen=True, slots=True)
class Stretch:
    """What to learn from: parameters (none: all with valid rows), since when, until when, hours at least.

    hours: None for what the configuration says.
    """

    parameters: Sequence[str] = ()
    since: str | None = None
    until: str | None = None
    hours: float | None = None


def learn(
    path: Path, rig: str | None, stretch: Stretch, progress: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Learn baselines and store them; return what was learnt. Nothing is stored where a part is not ready.

    progress: told how far long work is.
    Raises UsageError with what is still wanted of each parameter; ConfigError, StoreError.
    """
    if stretch.hours is not None and not stretch.hours > 0:
        raise UsageError.at("--hours", f"{stretch.hours:g} is no time", "give hours above 0, such as 24")
    target = target_of(path, rig)
    table = BaselineTable() if target.config is None else target.config.baseline
    hours = 24.0 * table.days if stretch.hours is None else stretch.hours
    found = list(_history(target, stretch, progress))
    progress("")
    ready = _covariates(target, table, found, hours)
    graph = target.graph(*_ends(found))
    learnt = [_baseline(points, graph, hours, ready) for points in found]
    numbers = maintenance.store_baselines(target.db, learnt)
    rows = {one.parameter: row(one, n) for one, n in zip(learnt, numbers, strict=True)}
    return {
        "rig": target.rig, "db": str(target.db), "hours": hours, "graph": graph, "parameters": rows,
        "warnings": [words for one in learnt if (words := _doubt(one))],
    }  # fmt: skip


def _ends(found: Sequence[Points]) -> tuple[int, int]:
    return int(min(points.t_ns[0] for points in found)), int(max(points.t_ns[-1] for points in found))


def _covariates(target: Target, table: BaselineTable, found: Sequence[Points], hours: float) -> list[Ready]:
    """Return a stretch's covariates. Raises UsageError with all that parameters and covariates still want."""
    faults = [fault for points in found if (fault := _unready(points, hours))]
    stretches = [points for points in found if len(points.t_ns)]
    ready, unusable = read(target, table, *_ends(stretches)) if stretches else ([], [])
    period_s = hours * 3600.0 / LEAST_PERIODS
    for points in () if faults else stretches:
        unusable += unready(points, period_s, ready, LEAST_PERIODS)
        alike = same(points, ready)
        unusable += [] if alike is None else [alike]
    if faults or unusable:
        raise UsageError(list({fault.path: fault for fault in reversed([*faults, *unusable])}.values())[::-1])
    return ready


def _doubt(one: Baseline) -> str:
    """Return why a baseline is little to rely on; empty where it is not."""
    if one.n_effective >= DOUBTFUL_PERIODS:
        return ""
    few = number(one.n_effective, 2)
    told = f"{one.parameter} moved so slowly that its periods tell no more than {few} independent ones"
    return f"{told}: it drifts (see deltak trend), or the stretch is too short"


def _history(target: Target, stretch: Stretch, progress: Callable[[str], None]) -> Iterable[Points]:
    """Yield the valid rows of each parameter asked for; of all, those that have any."""
    known = queries.parameters(target.db, target.rig)
    if unknown := [name for name in stretch.parameters if name not in known]:
        advice = f"parameters are {', '.join(known) or 'none yet'}"
        raise UsageError.at("--parameter", f'the database has no parameter "{unknown[0]}"', advice)
    any_valid = False
    for name in stretch.parameters or known:
        progress(f"reading {name}")
        points = points_of(target.db, target.rig, name, stretch.since, stretch.until)
        if stretch.parameters or len(points.t_ns):
            any_valid = True
            yield points
    if not any_valid:
        what = f"{target.rig} has no valid row in this stretch"
        raise UsageError.at(
            "--since", what, "let the agent run while the machine moves, or ask for another stretch"
        )


def _unready(points: Points, hours: float) -> Fault | None:
    """Return what a parameter still wants; None where it has enough."""
    have = 0
    if len(points.t_ns):
        have = len(np.unique(periods(points.t_ns / 1e9, hours * 3600.0 / LEAST_PERIODS)))
    if have >= LEAST_PERIODS:
        return None
    share = have / LEAST_PERIODS
    wanted, unit = (hours, "hours") if hours >= 1.0 else (hours * 3600.0, "s")
    what = f"not yet: {number(share * wanted, 3)} of {wanted:g} {unit} with valid rows ({percent(share)})"
    return Fault(points.parameter, what, "let the agent run on, or ask for less with --hours")


def _baseline(points: Points, graph: str, hours: float, ready: Sequence[Ready]) -> Baseline:
    period_s = hours * 3600.0 / LEAST_PERIODS
    rows = known_rows(points, ready)
    t_ns, value = points.t_ns[rows], points.value[rows]
    depending = depends(t_ns, value, period_s, ready)
    still = taken_out(t_ns, value, depending, {one.name: one for one in ready})
    found = spread(t_ns / 1e9, still, period_s)
    return Baseline(
        points.rig, points.parameter, points.unit, graph, found.reference, found.sd, found.spread_sd,
        found.within_sd,
        found.days_sd, found.correlation_s, found.n_effective, written(depending), int(t_ns[0]),
        int(t_ns[-1]),
        len(t_ns),
    )  # fmt: skip


def row(one: Baseline, baseline_id: int | None) -> dict[str, Any]:
    """Return what is said of a baseline in documents."""
    return {
        "baseline_id": baseline_id, "unit": one.unit, "reference": one.reference, "sd": one.sd,
        "spread_sd": one.spread_sd, "within_sd": one.within_sd, "days_sd": one.days_sd,
        "correlation_s": one.correlation_s, "n_effective": one.n_effective, "n": one.n,
        "from_ns": one.from_ns,
        "until_ns": one.until_ns, "covariates": json.loads(one.covariates),
    }  # fmt: skip
