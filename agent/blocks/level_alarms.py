"""Health assessment: level alarms raised by probability, with delays, a deadband and the states of ISA-18.2.

Each judged row asks two questions of Student's t with the row's own standard deviation and degrees of
freedom:

    raise   P(|Δ| > limit)            ≥ confidence at every row for the on-delay, at least half a window
    clear   P(|Δ| < limit − deadband) ≥ confidence at every row for the off-delay

Rows that are not VALID answer neither and pause both timers, so missing data never clears an alarm. Timers
count sample indices, never a clock: a step of the wall clock changes no alarm.

    NORM, RTNUN --raise--> UNACK --clear--> RTNUN      a raise is an activation of its own, also from RTNUN
                           ACKED --clear--> NORM       where an earlier run left it so

What operators do meanwhile is not this block's: `advisory/alarm_states.py` takes each step as their commands
have it.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, Protocol

import numpy as np

from agent.numerics.exceedance import Deviations
from agent.numerics.preprocessing.rows import steps_from
from agent.text import behind, number, with_sd
from agent.types import AlarmState, AlarmTransition, BoolArray, EstimateBatch, FloatArray, IntArray, Status

_RAISED: Final[Mapping[AlarmState, AlarmState]] = {"NORM": "UNACK", "RTNUN": "UNACK"}
_CLEARED: Final[Mapping[AlarmState, AlarmState]] = {"UNACK": "RTNUN", "ACKED": "NORM"}


class LevelRule(Protocol):
    """One `[[alarm]]` table of the configuration; None stands for the key's default."""

    @property
    def parameter(self) -> str: ...
    @property
    def limit(self) -> float | None: ...
    @property
    def limit_percent(self) -> float | None: ...
    @property
    def side(self) -> str: ...
    @property
    def confidence(self) -> float: ...
    @property
    def deadband(self) -> float | None: ...
    @property
    def on_delay_s(self) -> float | None: ...
    @property
    def off_delay_s(self) -> float | None: ...
    @property
    def priority(self) -> str: ...
    @property
    def advice(self) -> str | None: ...


class _Timers:
    """For how many samples a condition has held, one column a rule."""

    def __init__(self, rules: int) -> None:
        self.held: IntArray = np.zeros(rules, dtype=np.int64)
        self.met: BoolArray = np.zeros(rules, dtype=np.bool_)

    def advance(self, steps: IntArray, met: BoolArray, assessed: BoolArray) -> IntArray:
        """Return for how many samples the condition has held at each row, (N, r).

        steps (N, 1) samples since the row before, met (N, r) rows that meet the condition, judged (N, r) rows
        that could. The time between two rows counts when both meet it; a judged row that does not starts from
        zero again.
        """
        before = np.vstack([self.met, met[:-1]])
        total = self.held + np.cumsum(np.where(met & before, steps, 0), axis=0)
        elapsed: IntArray = total - np.maximum.accumulate(np.where(assessed & ~met, total, 0), axis=0)
        self.held, self.met = elapsed[-1].copy(), met[-1].copy()
        return elapsed


class LevelAlarms:
    """Level alarms of a rig: batches of estimates in, transitions out; splitting a batch changes nothing.

    rules: the configuration's alarm tables, at most one a parameter. sample_rate_hz turns delays into
    samples. Raises ValueError for a rule that cannot be judged.
    """

    def __init__(self, rig: str, rules: Sequence[LevelRule], sample_rate_hz: float) -> None:
        for rule in rules:
            _check(rule)
        self._rig = rig
        self._rules = tuple(rules)
        self._rate = sample_rate_hz
        self._up = np.array([rule.side != "low" for rule in rules], dtype=np.bool_)
        self._down = np.array([rule.side != "high" for rule in rules], dtype=np.bool_)
        self._confidence = np.array([rule.confidence for rule in rules])
        self.reset()

    def reset(self) -> None:
        """Forget everything: all alarms NORM, timers at zero."""
        self._states: list[AlarmState] = ["NORM"] * len(self._rules)
        self._on, self._off = _Timers(len(self._rules)), _Timers(len(self._rules))
        self._index: int | None = None

    @property
    def states(self) -> dict[str, AlarmState]:
        """The state of each parameter's alarm."""
        return {rule.parameter: state for rule, state in zip(self._rules, self._states, strict=True)}

    def step(self, batch: EstimateBatch) -> list[AlarmTransition]:
        """Judge the rows of a batch and return what they changed, in the order of time.

        Raises ValueError when the batch lacks a rule's parameter.
        """
        if not self._rules or not len(batch):
            return []
        missing = set(self.states).difference(batch.parameters)
        if missing:
            raise ValueError(f"alarms on {', '.join(sorted(missing))}, which the estimates do not carry")
        columns = [batch.parameters.index(rule.parameter) for rule in self._rules]
        judgement = _Judgement(batch, columns, self._up, self._down, self._rules)
        steps = steps_from(int(batch.index[0]) if self._index is None else self._index, batch.index)[:, None]
        self._index = int(batch.index[-1])
        due_on = self._due_on(judgement, steps)
        due_off = self._due_off(judgement, steps, np.logical_or.reduce(due_on))
        changes = sorted((row, i) for i in range(len(columns)) for row in self._changes(i, due_on, due_off))
        return [self._turn(judgement, row, i) for row, i in changes]

    def snapshot(self) -> dict[str, Any]:
        """Return the whole state as plain values that JSON carries."""
        alarms = {
            parameter: {
                "state": state,
                "on": [int(self._on.held[i]), bool(self._on.met[i])],
                "off": [int(self._off.held[i]), bool(self._off.met[i])],
            }
            for i, (parameter, state) in enumerate(self.states.items())
        }
        return {"index": self._index, "alarms": alarms}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take up a snapshot; alarms that it does not name start as NORM, those without a rule are left out.

        States alone, `{"alarms": {"k1": {"state": "UNACK"}}}`, are enough: timers then start from zero.
        """
        self.reset()
        self._index = state.get("index")
        for i, rule in enumerate(self._rules):
            saved = state["alarms"].get(rule.parameter)
            if saved is not None:
                self._states[i] = saved["state"]
                self._on.held[i], self._on.met[i] = saved.get("on", (0, False))
                self._off.held[i], self._off.met[i] = saved.get("off", (0, False))

    def _due_on(self, judgement: "_Judgement", steps: IntArray) -> BoolArray:
        """Return the rows (N, r) at which the condition for raising has held for its delay."""
        met = judgement.deviations.exceed(judgement.limit, self._confidence, judgement.assessed)
        held = self._on.advance(steps, met, judgement.assessed)
        due: BoolArray = met & (held >= self._samples(judgement.on_delay_s()))
        return due

    def _due_off(self, judgement: "_Judgement", steps: IntArray, raising: BoolArray) -> BoolArray:
        """Return the rows (N, r) at which the condition for clearing has held for its delay.

        Alarms that neither stand nor are raised in this batch are left out: raising starts their timer anew.
        """
        among = judgement.assessed & (raising | np.array([state in _CLEARED for state in self._states]))
        met = judgement.deviations.stay_within(judgement.level, self._confidence, among)
        held = self._off.advance(steps, met, judgement.assessed)
        delay = np.array([rule.off_delay_s or 0.0 for rule in self._rules])
        due: BoolArray = met & (held >= self._samples(delay))
        return due

    def _samples(self, seconds: FloatArray) -> IntArray:
        """Return delays as whole samples, rounded up but for what binary fractions add."""
        return np.ceil(seconds * self._rate - 1e-6).astype(np.int64)

    def _changes(self, i: int, due_on: BoolArray, due_off: BoolArray) -> Iterator[int]:
        """Yield the rows at which rule i is raised and cleared by turns."""
        row = 0
        stands = self._states[i] in _CLEARED
        while row < len(due_on):
            due = (due_off if stands else due_on)[row:, i]
            ahead = int(due.argmax())
            if not due[ahead]:
                return
            yield row + ahead
            row, stands = row + ahead + 1, not stands

    def _turn(self, judgement: "_Judgement", row: int, i: int) -> AlarmTransition:
        """Take rule i through its change at a row."""
        before = self._states[i]
        raising = before in _RAISED
        after = self._states[i] = (_RAISED if raising else _CLEARED)[before]
        return judgement.transition(row, i, before, after)


class _Judgement:
    """One batch as the rules see it: one column a rule."""

    def __init__(
        self,
        batch: EstimateBatch,
        columns: list[int],
        up: BoolArray,
        down: BoolArray,
        rules: tuple[LevelRule, ...],
    ) -> None:
        value = batch.value[:, columns]
        sd = _deviation_sd(batch, columns)
        self.batch, self.columns, self.rules = batch, columns, rules
        self.assessed: BoolArray = (
            (batch.status[:, columns] == Status.VALID) & np.isfinite(value) & np.isfinite(sd)
        )
        self.deviations = Deviations(value - batch.reference[columns], sd, batch.dof, up, down)
        origins = zip(rules, batch.reference[columns], strict=True)
        self.limit = np.array([_limit(rule, float(origin)) for rule, origin in origins])
        self.level = np.array(
            [_level(rule, float(limit)) for rule, limit in zip(rules, self.limit, strict=True)]
        )

    def on_delay_s(self) -> FloatArray:
        """Return each row's on-delay (N, r): at least half the row's window, the whole of it by default."""
        window = self.batch.window_s[:, self.columns]
        asked = np.array([np.nan if rule.on_delay_s is None else rule.on_delay_s for rule in self.rules])
        delay: FloatArray = np.where(np.isnan(asked), window, np.maximum(asked, 0.5 * window))
        return delay

    def transition(self, row: int, i: int, before: AlarmState, after: AlarmState) -> AlarmTransition:
        """Make the transition of rule i at a row, with its figures and its sentence."""
        raising = after == "UNACK"
        edge = self.limit if raising else self.level
        beyond = float(self.deviations.beyond(edge, (np.array([row]), np.array([i])))[0])
        delta, sd = float(self.deviations.delta[row, i]), float(self.deviations.sd[row, i])
        rule = self.rules[i]
        return AlarmTransition(
            rig=self.batch.rig,
            kind="level",
            parameter=rule.parameter,
            priority=rule.priority,
            t_ns=int(self.batch.t_ns[row]),
            from_state=before,
            to_state=after,
            cause="raise" if raising else "clear",
            message=self._sentence(i, delta, sd, raising=raising),
            delta=delta,
            sd=sd,
            limit_value=float(self.limit[i]),
            probability=beyond if raising else 1.0 - beyond,
            advice=rule.advice,
            percent=_percent(delta, float(self.batch.reference[self.columns[i]])),
        )

    def _sentence(self, i: int, delta: float, sd: float, *, raising: bool) -> str:
        column = self.columns[i]
        figures = (
            f"{with_sd(abs(delta), sd)}{behind(self.batch.units[column])} {self._place(column, delta)} "
            f"(limit {number(float(self.limit[i]))})"
        )
        remark = self.batch.remarks[column] if self.batch.remarks is not None else ""
        unsure = f"; the reference is less well known: {remark}" if remark else ""
        return f"{self.rules[i].parameter} is {'' if raising else 'back within its limit: '}{figures}{unsure}"

    def _place(self, column: int, delta: float) -> str:
        """Return in words on which side of what its deviation is counted from."""
        side = "above" if delta > 0 else "below"
        learnt = self.batch.baseline_id is not None and self.batch.baseline_id[column] is not None
        origin = "its baseline" if learnt else "nominal"
        return f"{side} {origin} {number(float(self.batch.reference[column]))}"


def _percent(delta: float, reference: float) -> float | None:
    """Return a change as a per cent of the reference's size; None of a reference of 0."""
    return 100.0 * delta / abs(reference) if reference else None


def _deviation_sd(batch: EstimateBatch, columns: list[int]) -> FloatArray:
    """Return the sd (N, r) of each row's deviation from its reference.

    A reference that was learnt is of the same masses and gains as the row, whose sd against it is sd_repeat
    therefore.
    """
    sd = batch.sd[:, columns]
    if batch.reference_sd is None:
        return sd
    learnt = np.array(batch.reference_sd)[columns]
    repeat = batch.sd_repeat[:, columns]
    return np.where(np.isfinite(learnt) & np.isfinite(repeat), np.hypot(repeat, learnt), sd)


def _limit(rule: LevelRule, reference: float) -> float:
    """Return the limit in the parameter's unit; infinite for a percentage of a zero reference."""
    if rule.limit is not None:
        return rule.limit
    return abs(reference) * (rule.limit_percent or 0.0) / 100.0 or float("inf")


def _level(rule: LevelRule, limit: float) -> float:
    """Return the level under which the alarm clears: limit less deadband, by default a tenth of the limit."""
    return limit - (0.1 * limit if rule.deadband is None else rule.deadband)


def _check(rule: LevelRule) -> None:
    """Refuse what the arithmetic cannot judge. Raises ValueError."""
    if (rule.limit is None) == (rule.limit_percent is None):
        raise ValueError(f"alarm on {rule.parameter}: exactly one of limit and limit_percent is needed")
    if not 0.5 <= rule.confidence < 1.0:
        raise ValueError(f"alarm on {rule.parameter}: confidence {rule.confidence} is not in [0.5, 1)")
