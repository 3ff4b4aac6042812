"""Baselines as rows: those of a rig that stand, one a parameter."""

import sqlite3
from collections.abc import Sequence
from dataclasses import replace

from agent.records import Baseline
from agent.storage.database.checksum import checked
from agent.storage.tables.rows import Names, Numbers, Plan

_OF_RIG = """SELECT b.seq, b.rig_id, b.parameter, b.unit, b.graph, b.reference, b.sd, b.spread_sd,
 b.within_sd,
 b.days_sd, b.correlation_s, b.n_effective, b.covariates, b.from_ns, b.until_ns, b.n, b.crc
 FROM baselines b JOIN rigs g ON g.seq = b.rig_id WHERE g.name = ? ORDER BY b.seq"""


def plan_of(baselines: Sequence[Baseline], names: Names, numbers: Numbers) -> tuple[Plan, list[Baseline]]:
    """Return the rows that add baselines, and these with their numbers."""
    plan = Plan()
    numbered = [replace(one, baseline_id=numbers.take("baselines")) for one in baselines]
    for one in numbered:
        figures = (
            one.reference,
            one.sd,
            one.spread_sd,
            one.within_sd,
            one.days_sd,
            one.correlation_s,
            one.n_effective,
        )
        plan.sealed(
            "baselines", one.baseline_id, names.rig(one.rig), one.parameter, one.unit, one.graph, *figures,
            one.covariates, one.from_ns, one.until_ns, one.n,
        )  # fmt: skip
    return plan, numbered


def standing_baselines(connection: sqlite3.Connection, rig: str) -> tuple[Baseline, ...]:
    """Return the newest baseline of each parameter of a rig; a damaged row is passed over."""
    found: dict[str, Baseline] = {}
    for cells in map(checked, connection.execute(_OF_RIG, (rig,))):
        if cells is not None:
            number, _, *facts = cells
            one = Baseline(rig, *facts)
            found[one.parameter] = replace(one, baseline_id=number)
    return tuple(found.values())
