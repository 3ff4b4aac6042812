"""Prognostic assessment: alarms where a forecast reaches a limit soon, and where a parameter drifts too fast.

    forecast   raise  P50 of the first passage is nearer than `within`, status ok
               clear  it is a tenth farther than that, or nothing leads there any more
    rate       raise  P(|slope| > rate_per_day)       ≥ confidence, on the side that is asked for
               clear  P(|slope| < 0.9 rate_per_day)   ≥ confidence

A history that is too short to say raises and clears nothing, nor does a limit that is crossed: it has come.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from agent.alarms.life_cycle import CLEARED, RAISED
from agent.blocks.advisory.outlook import Outlook
from agent.blocks.tuning import DEADBAND
from agent.config.tables import Alarm as AlarmRule
from agent.text import ahead, behind, number, with_sd
from agent.types import AlarmKind, AlarmState, AlarmTransition
from agent.units import DAY_S

if TYPE_CHECKING:
    from agent.prognosis.change import Rates
    from agent.prognosis.forecast import Forecast


class StandingRow(Protocol):
    """An alarm that an earlier run left standing."""

    @property
    def kind(self) -> str: ...
    @property
    def parameter(self) -> str: ...
    @property
    def state(self) -> str: ...


@dataclass(frozen=True, slots=True)
class _Finding:
    """Whether to raise or clear an alarm (neither where it cannot be said), its figures and its words."""

    raised: bool
    cleared: bool
    delta: float
    sd: float
    limit: float
    probability: float
    words: str


class PrognosisAlarms:
    """The alarms of kind forecast and rate of one rig: outlooks in, transitions out."""

    def __init__(self, rig: str, rules: Sequence[AlarmRule]) -> None:
        self._rig = rig
        kinds: tuple[AlarmKind, ...] = ("forecast", "rate")
        self._rules = {(kind, rule.parameter): rule for rule in rules for kind in kinds if kind in rule.kinds}
        self._states: dict[tuple[AlarmKind, str], AlarmState] = dict.fromkeys(self._rules, "NORM")

    @property
    def states(self) -> Mapping[tuple[AlarmKind, str], AlarmState]:
        """The state of each alarm, by kind and parameter."""
        return self._states

    def restore(self, standing: Sequence[StandingRow]) -> None:
        """Go on with the alarms that the run before left standing, as far as there are rules for them."""
        for row in standing:
            key = (row.kind, row.parameter)
            if key in self._states:
                self._states[key] = row.state  # type: ignore[assignment]

    def step(self, outlook: Outlook) -> list[AlarmTransition]:
        """Look at one parameter and return what its alarms do."""
        changes = []
        for (kind, parameter), rule in self._rules.items():
            finding = None
            if parameter == outlook.parameter:
                finding = _foreseen(rule, outlook) if kind == "forecast" else _drift(rule, outlook)
            if finding is not None:
                changes += self._changed(kind, rule, outlook, finding)
        return changes

    def _changed(
        self, kind: AlarmKind, rule: AlarmRule, outlook: Outlook, found: _Finding
    ) -> list[AlarmTransition]:
        before = self._states[kind, rule.parameter]
        after = (RAISED if found.raised else CLEARED if found.cleared else {}).get(before)
        if after is None:
            return []
        self._states[kind, rule.parameter] = after
        change = AlarmTransition(
            rig=self._rig, kind=kind, parameter=rule.parameter, priority=rule.priority, t_ns=outlook.t_ns,
            from_state=before, to_state=after, cause="raise" if found.raised else "clear",
            message=found.words, delta=found.delta, sd=found.sd, limit_value=found.limit,
            probability=found.probability, advice=rule.advice,
        )  # fmt: skip
        return [change]


def _foreseen(rule: AlarmRule, outlook: Outlook) -> _Finding | None:
    """Return what a forecast says of its rule; None where it leaves open whether the limit is near."""
    made, within_s = outlook.forecast, rule.within
    if made is None or within_s is None:
        return None
    if made.status in {"too short", "crossed"}:
        return None
    p50_s = np.inf if made.p50 is None else made.p50 * DAY_S
    is_near = made.status == "ok" and p50_s < within_s
    is_far = p50_s > (1.0 + DEADBAND) * within_s
    chance = float(np.mean(made.passages * DAY_S <= within_s))
    return _Finding(
        is_near, is_far, outlook.value - outlook.reference, outlook.sd, outlook.way or 0.0, chance,
        _forecast_words(outlook, made, within_s, near=is_near),
    )  # fmt: skip


def _forecast_words(outlook: Outlook, made: "Forecast", within_s: float, *, near: bool) -> str:
    limit = f"its limit {number(outlook.way)}{behind(outlook.unit)}"
    if made.p10 is None or made.p50 is None or made.p90 is None:
        return f"{outlook.parameter}: nothing leads to {limit} any more"
    p10, p50, p90 = (ahead(days * DAY_S) for days in (made.p10, made.p50, made.p90))
    lead = "reaches" if near else "no alarm any more: reaches"
    return (
        f"{outlook.parameter} {lead} {limit} in {p50} (80 %: {p10} … {p90}; alarm within {ahead(within_s)})"
    )


def _drift(rule: AlarmRule, outlook: Outlook) -> _Finding | None:
    """Return what the newest slope says of its rule; None where it is not known, or neither is sure."""
    change, rate = outlook.change, rule.rate_per_day
    if change is None or rate is None:
        return None
    faster = _faster(change.rates, rule.side, rate)
    slower = 1.0 - _faster(change.rates, rule.side, (1.0 - DEADBAND) * rate)
    is_fast = faster >= rule.confidence
    slope = f"{with_sd(abs(change.newest), change.newest_sd)}{behind(outlook.unit)} a day"
    lead = f"{'falls' if change.newest < 0.0 else 'rises'} by" if is_fast else "is slow again, changes by"
    words = f"{outlook.parameter} {lead} {slope} (limit {number(rate)})"
    return _Finding(
        is_fast,
        slower >= rule.confidence,
        change.newest,
        change.newest_sd,
        rate,
        faster if is_fast else slower,
        words,
    )


def _faster(rates: "Rates", side: str, rate: float) -> float:
    """Return the probability that a parameter moves faster than a rate to a side."""
    rising = rates.above(rate)
    falling = 1.0 - rates.above(-rate)
    return {"high": rising, "low": falling}.get(side, rising + falling)
