"""What else could have been the cause, at an alarm's instant: other parameters, and the rig's constants."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from agent.config import Alarm
from agent.evaluation.explain.recompute import Recomputed
from agent.reference.exceedance import Deviations
from agent.types import EstimateBatch, Reason, Status, Verdict


@dataclass(frozen=True, slots=True)
class Rival:
    """What was believed of a parameter: its change, the limit on it, and how probable it lies beyond."""

    name: str
    delta: float
    sd: float
    unit: str
    limit: float | None
    probability: float | None
    status: str


@dataclass(frozen=True, slots=True)
class Tested:
    """Everything that was tested at an instant.

    Attributes:
        parameters: of every parameter, that of the alarm first.
        constants: of masses, gains, delays, what was said last.
        confidence: what the alarm asks of its probability; None where it asks for none.
        window_s, n_used, n_missing: the samples that the estimates rest on; None where there is no such row.
    """

    parameters: tuple[Rival, ...] = ()
    constants: tuple[Verdict, ...] = ()
    confidence: float | None = None
    window_s: float | None = None
    n_used: int | None = None
    n_missing: int | None = None


def tested(again: Recomputed, alarm: Mapping[str, Any], t_ns: int) -> Tested:
    """Return what was tested at the row of an alarm."""
    newest = {one.hypothesis: one for one in again.verdicts if one.t_ns <= t_ns}
    rules = {rule.parameter: rule for rule in again.config.alarm}
    rule = rules.get(alarm["parameter"])
    confidence = rule.confidence if rule is not None and alarm["kind"] == "level" else None
    for batch in again.batches:
        (rows,) = np.nonzero(batch.t_ns == t_ns)
        if len(rows):
            row = int(rows[0])
            found = sorted(_rivals(batch, row, rules), key=lambda one: one.name != alarm["parameter"])
            used, missing = int(batch.n_used[row]), int(batch.n_missing[row])
            window_s = float(np.max(batch.window_s[row]))
            return Tested(tuple(found), tuple(newest.values()), confidence, window_s, used, missing)
    return Tested((), tuple(newest.values()), confidence)


def _rivals(batch: EstimateBatch, row: int, rules: Mapping[str, Alarm]) -> Iterator[Rival]:
    for column, name in enumerate(batch.parameters):
        delta = float(batch.value[row, column] - batch.reference[column])
        sd = float(batch.sd[row, column])
        limit = _limit(rules.get(name), float(batch.reference[column]))
        beyond = None if limit is None else _beyond(delta, sd, float(batch.dof[row]), limit, rules[name].side)
        yield Rival(name, delta, sd, batch.units[column], limit, beyond, _status(batch, row, column))


def _limit(rule: Alarm | None, reference: float) -> float | None:
    if rule is None or (rule.limit is None and rule.limit_percent is None):
        return None
    return rule.limit if rule.limit is not None else abs(reference) * (rule.limit_percent or 0.0) / 100.0


def _beyond(delta: float, sd: float, dof: float, limit: float, side: str) -> float:
    up, down = (np.array([side != other], dtype=np.bool_) for other in ("low", "high"))
    deviations = Deviations(np.array([[delta]]), np.array([[sd]]), np.array([dof]), up, down)
    return float(deviations.beyond(np.array([limit]), (np.array([0]), np.array([0])))[0])


def _status(batch: EstimateBatch, row: int, column: int) -> str:
    """Return an estimate's status, with its reason where it has one."""
    status = Status(int(batch.status[row, column])).name.lower()
    reason = Reason(int(batch.reason[row, column]))
    return status if reason is Reason.NONE else f"{status} ({reason.name.lower().replace('_', ' ')})"
