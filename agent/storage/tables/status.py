"""Health, event, verdict and condition rows: ledgers, what happened once, constants, windows of the paper."""

import json
from collections.abc import Mapping
from dataclasses import asdict

from agent.records import ConditionsRecord, CovariateMean, Health, HealthEvent, SourceClock
from agent.storage.tables.rows import Numbers, Plan, finite
from agent.types import Verdict


class HealthRows:
    """Which row each source's ledger has at its newest instant.

    There is one row an instant and source, and the last one reported counts: while no sample comes the
    instant stays, and what else was counted changes that row instead of adding more of them.
    """

    def __init__(self) -> None:
        self._rows: dict[tuple[int, str], tuple[int, int]] = {}

    def apply(self, plan: Plan, record: Health, run_id: int, numbers: Numbers) -> None:
        """Add a ledger's row to a plan; the reasons travel in it as JSON, which the view takes apart."""
        sums = (
            record.received,
            record.used,
            sum(record.rejected.values()),
            sum(record.dropped.values()),
            record.gaps,
        )
        counts = (int(n) for n in sums)
        cells = (record.source, record.t_ns, *counts, finite(record.lag_s), _reasons(record))
        plan.sealed("health", self._seq(record, run_id, numbers), run_id, *cells)

    def _seq(self, record: Health, run_id: int, numbers: Numbers) -> int:
        t_ns, seq = self._rows.get((run_id, record.source), (None, 0))
        if t_ns != record.t_ns:
            seq = numbers.take("health")
            self._rows[run_id, record.source] = record.t_ns, seq
        return seq


def _reasons(record: Health) -> str | None:
    kinds = {
        "rejected": _counted(record.rejected), "dropped": _counted(record.dropped),
        "faults": _counted(record.faults), "clock": _figures(record.clock),
    }  # fmt: skip
    known = {kind: reasons for kind, reasons in kinds.items() if reasons}
    return json.dumps(known, sort_keys=True) if known else None


def _figures(clock: SourceClock | None) -> dict[str, float]:
    """What is known of a source's time; v_health takes it out again."""
    return (
        {} if clock is None else {name: value for name, value in asdict(clock).items() if value is not None}
    )


def _counted(reasons: Mapping[str, int]) -> dict[str, int]:
    return {reason: int(count) for reason, count in reasons.items() if count}


def add_event(plan: Plan, record: HealthEvent, run_id: int, numbers: Numbers) -> None:
    """Add something that happened once."""
    plan.sealed(
        "events", numbers.take("events"), run_id, record.source, record.t_ns, record.cause, record.message
    )


def add_verdict(plan: Plan, record: Verdict, run_id: int, numbers: Numbers) -> None:
    """Add what is believed of a constant of the rig; what is no number is stored as NULL."""
    size, sd, probability = map(finite, (record.size, record.sd, record.probability))
    seq = numbers.take("hypotheses")
    plan.sealed("hypotheses", seq, run_id, record.t_ns, record.hypothesis, size, sd, record.unit, probability)


def add_conditions(plan: Plan, record: ConditionsRecord, run_id: int, numbers: Numbers) -> None:
    """Add what the conditions say of a window; what is no number is stored as NULL."""
    found = record.found
    trail = json.dumps([dict(zip(record.parameters, map(finite, row), strict=True)) for row in found.trail])
    plan.sealed(
        "conditions", numbers.take("conditions"), run_id, record.t_ns, record.window_s, finite(found.defect),
        finite(found.defect_outputs), found.rank, found.rank_joined, finite(found.defect_special),
        int(found.z_zero), found.iterations, int(found.converged), finite(found.cost), finite(found.step),
        found.passes, finite(found.ratio), trail,
    )  # fmt: skip


def add_mean(plan: Plan, mean: CovariateMean, run_id: int, numbers: Numbers) -> None:
    """Add the mean of a covariate over a period to a plan."""
    number = numbers.take("covariates")
    plan.sealed(
        "covariates", number, run_id, mean.span_s, mean.t_ns, mean.name, mean.unit, mean.value, mean.n
    )
