"""`deltak baseline learn`: references and their spread from the valid rows of a healthy stretch.

valid rows -> means of equal periods -> robust reference, spread between periods and days -> v_baselines. The periods
are a 24th of what is wanted at least: hours, of a day.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from agent.commissioning.baseline.target import Target, target_of
from agent.errors import Fault, UsageError
from agent.numerics.reference.spread import periods, spread
from agent.storage import maintenance
from agent.storage.read import queries
from agent.storage.read.queries import Points
from agent.text import number, percent
from agent.types import Baseline

LEAST_PERIODS = 24
"""Periods that a baseline needs: the spread of fewer is known to no better than a fifth."""
DOUBTFUL = 5.0
"""Independent periods below which what was learnt may be a drift."""
HOURS = 24.0
"""What is wanted at least by default: a machine's day."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """What to learn from: which parameters (none: all with valid rows), since when, until when, hours at least."""

    parameters: Sequence[str] = ()
    since: str | None = None
    until: str | None = None
    hours: float = HOURS


def learn(
    path: Path, rig: str | None, stretch: Stretch, progress: Callable[[str], None] = lambda _: None
) -> dict[str, Any]:
    """Learn baselines and store them; return what was learnt. Nothing is stored where a part is not ready.

    progress: told how far long work is.
    Raises UsageError with what is still wanted of each parameter; ConfigError, StoreError.
    """
    if not stretch.hours > 0:
        raise UsageError.at("--hours", f"{stretch.hours:g} is no time", "give hours above 0, such as 24")
    target = target_of(path, rig)
    found = list(_history(target, stretch, progress))
    progress("")
    if faults := [fault for points in found if (fault := _unready(points, stretch.hours))]:
        raise UsageError(faults)
    graph = target.graph(int(min(p.t_ns[0] for p in found)), int(max(p.t_ns[-1] for p in found)))
    learnt = [_baseline(points, graph, stretch.hours) for points in found]
    numbers = maintenance.store_baselines(target.db, learnt)
    rows = {one.parameter: row(one, n) for one, n in zip(learnt, numbers, strict=True)}
    return {
        "rig": target.rig, "db": str(target.db), "hours": stretch.hours, "graph": graph, "parameters": rows,
        "warnings": [words for one in learnt if (words := _doubt(one))],
    }  # fmt: skip


def _doubt(one: Baseline) -> str:
    """Return why a baseline is little to rely on; empty where it is not."""
    if one.n_effective >= DOUBTFUL:
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
        points = queries.points(target.db, target.rig, name, stretch.since, stretch.until)
        if stretch.parameters or len(points.t_ns):
            any_valid = True
            yield points
    if not any_valid:
        what = f"{target.rig} has no valid row in this stretch"
        raise UsageError.at("--since", what, "let the agent run while the machine moves, or ask for another stretch")


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


def _baseline(points: Points, graph: str, hours: float) -> Baseline:
    found = spread(points.t_ns / 1e9, points.value, hours * 3600.0 / LEAST_PERIODS)
    return Baseline(
        points.rig, points.parameter, points.unit, graph, found.reference, found.sd, found.spread_sd, found.within_sd,
        found.days_sd, found.correlation_s, found.n_effective, "[]", int(points.t_ns[0]), int(points.t_ns[-1]),
        len(points.t_ns),
    )  # fmt: skip


def row(one: Baseline, baseline_id: int | None) -> dict[str, Any]:
    """Return what is said of a baseline in documents."""
    return {
        "baseline_id": baseline_id, "unit": one.unit, "reference": one.reference, "sd": one.sd,
        "spread_sd": one.spread_sd, "within_sd": one.within_sd, "days_sd": one.days_sd,
        "correlation_s": one.correlation_s, "n_effective": one.n_effective, "n": one.n, "from_ns": one.from_ns,
        "until_ns": one.until_ns,
    }  # fmt: skip
