"""Health assessment: level alarms raised by probability, with delays, a deadband and the states of ISA-18.2.

Two tests by Student's t are made of each valid row, with its own standard deviation and degrees of
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

import numpy as np

from agent.alarms.life_cycle import CLEARED, RAISED
from agent.config.tables import Alarm as AlarmRule
from agent.numerics.preprocessing.rows import steps_from
from agent.reference.exceedance import Deviations
from agent.text import behind, number, with_sd
from agent.types import AlarmState, AlarmTransition, BoolArray, EstimateBatch, FloatArray, IntArray, Status


class _Timers:
    """For how many samples a condition has held, one column a rule."""

    def __init__(self, rules: int) -> None:
        self.held: IntArray = np.zeros(rules, dtype=np.int64)
        self.met: BoolArray = np.zeros(rules, dtype=np.bool_)

    def advance(self, steps: IntArray, met: BoolArray, assessed: BoolArray) -> IntArray:
        """Return for how many samples the condition has held at each row, (N, r).

        steps (N, 1) samples since the row before, met (N, r) rows that meet the condition, assessed (N, r)
        rows that could. The time between two rows counts when both meet it; an assessed row that does not
        starts from zero again.
        """
        before = np.vstack([self.met, met[:-1]])
        total = self.held + np.cumsum(np.where(met & before, steps, 0), axis=0)
        elapsed: IntArray = total - np.maximum.accumulate(np.where(assessed & ~met, total, 0), axis=0)
        self.held, self.met = elapsed[-1].copy(), met[-1].copy()
        return elapsed


class LevelAlarms:
    """Level alarms of a rig: batches of estimates in, transitions out; splitting a batch changes nothing.

    rules: the configuration's alarm tables, at most one a parameter. sample_rate_hz turns delays into
    samples. Raises ValueError for a rule that cannot be applied.
    """

    def __init__(self, rig: str, rules: Sequence[AlarmRule], sample_rate_hz: float) -> None:
        for rule in rules:
            _check(rule)
        self._rig = rig
        self._rules = tuple(rules)
        self._rate = sample_rate_hz
        self._up = np.array([rule.side != "low" for rule in rules], dtype=np.bool_)
        self._down = np.array([rule.side != "high" for rule in rules], dtype=np.bool_)
        self._confidence = np.array([rule.confidence for rule in rules])
        self._states: list[AlarmState] = ["NORM"] * len(self._rules)
        self._on, self._off = _Timers(len(self._rules)), _Timers(len(self._rules))
        self._index: int | None = None

    @property
    def states(self) -> dict[str, AlarmState]:
        """The state of each parameter's alarm."""
        return {rule.parameter: state for rule, state in zip(self._rules, self._states, strict=True)}

    def step(self, batch: EstimateBatch) -> list[AlarmTransition]:
        """Test the rows of a batch and return what they changed, in the order of time.

        Raises ValueError when the batch lacks a rule's parameter.
        """
        if not self._rules or not len(batch):
            return []
        missing = set(self.states).difference(batch.parameters)
        if missing:
            raise ValueError(f"alarms on {', '.join(sorted(missing))}, which the estimates do not carry")
        columns = [batch.parameters.index(rule.parameter) for rule in self._rules]
        assessment = _Assessment(batch, columns, self._up, self._down, self._rules)
        steps = steps_from(int(batch.index[0]) if self._index is None else self._index, batch.index)[:, None]
        self._index = int(batch.index[-1])
        due_on = self._due_on(assessment, steps)
        due_off = self._due_off(assessment, steps, np.logical_or.reduce(due_on))
        changes = sorted((row, i) for i in range(len(columns)) for row in self._changes(i, due_on, due_off))
        return [self._turn(assessment, row, i) for row, i in changes]

    def restore(self, states: Mapping[str, AlarmState]) -> None:
        """Go on from states by parameter, before the first row; those not named are NORM, timers at zero."""
        self._states = [states.get(rule.parameter, "NORM") for rule in self._rules]

    def _due_on(self, assessment: "_Assessment", steps: IntArray) -> BoolArray:
        """Return the rows (N, r) at which the condition for raising has held for its delay."""
        met = assessment.deviations.exceed(assessment.limit, self._confidence, assessment.assessed)
        held = self._on.advance(steps, met, assessment.assessed)
        due: BoolArray = met & (held >= self._samples(assessment.on_delay_s()))
        return due

    def _due_off(self, assessment: "_Assessment", steps: IntArray, raising: BoolArray) -> BoolArray:
        """Return the rows (N, r) at which the condition for clearing has held for its delay.

        Alarms that neither stand nor are raised in this batch are left out: raising starts their timer anew.
        """
        among = assessment.assessed & (raising | np.array([state in CLEARED for state in self._states]))
        met = assessment.deviations.stay_within(assessment.level, self._confidence, among)
        held = self._off.advance(steps, met, assessment.assessed)
        delay = np.array([rule.off_delay_s or 0.0 for rule in self._rules])
        due: BoolArray = met & (held >= self._samples(delay))
        return due

    def _samples(self, seconds: FloatArray) -> IntArray:
        """Return delays as whole samples, rounded up but for what binary fractions add."""
        return np.ceil(seconds * self._rate - 1e-6).astype(np.int64)

    def _changes(self, i: int, due_on: BoolArray, due_off: BoolArray) -> Iterator[int]:
        """Yield the rows at which rule i is raised and cleared by turns."""
        row = 0
        stands = self._states[i] in CLEARED
        while row < len(due_on):
            due = (due_off if stands else due_on)[row:, i]
            ahead = int(due.argmax())
            if not due[ahead]:
                return
            yield row + ahead
            row, stands = row + ahead + 1, not stands

    def _turn(self, assessment: "_Assessment", row: int, i: int) -> AlarmTransition:
        """Take rule i through its change at a row."""
        before = self._states[i]
        raising = before in RAISED
        after = self._states[i] = (RAISED if raising else CLEARED)[before]
        return assessment.transition(row, i, before, after)


class _Assessment:
    """One batch as the rules see it: one column a rule."""

    def __init__(
        self,
        batch: EstimateBatch,
        columns: list[int],
        up: BoolArray,
        down: BoolArray,
        rules: tuple[AlarmRule, ...],
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


def _limit(rule: AlarmRule, reference: float) -> float:
    """Return the limit in the parameter's unit; infinite for a percentage of a zero reference."""
    if rule.limit is not None:
        return rule.limit
    return abs(reference) * (rule.limit_percent or 0.0) / 100.0 or float("inf")


def _level(rule: AlarmRule, limit: float) -> float:
    """Return the level under which the alarm clears: limit less deadband, by default a tenth of the limit."""
    return limit - (0.1 * limit if rule.deadband is None else rule.deadband)


def _check(rule: AlarmRule) -> None:
    """Refuse what the arithmetic cannot apply. Raises ValueError."""
    if (rule.limit is None) == (rule.limit_percent is None):
        raise ValueError(f"alarm on {rule.parameter}: exactly one of limit and limit_percent is needed")
    if not 0.5 <= rule.confidence < 1.0:
        raise ValueError(f"alarm on {rule.parameter}: confidence {rule.confidence} is not in [0.5, 1)")
