# ruff: noqa: S608 - statements are put together from this package's own names; values are always bound
"""Alarm rows: one an activation, updated by the transitions of its life, each kept as an event."""

import sqlite3
from dataclasses import dataclass, replace
from typing import get_args

from agent.alarms.life_cycle import STATES, SUPPRESSED, Alarm, cause_of, is_needless
from agent.storage.database.checksum import Cell
from agent.storage.database.columns import columns_of
from agent.storage.tables.notifications import Outbox
from agent.storage.tables.rows import Numbers, Plan, finite
from agent.types import AlarmKind, AlarmState, AlarmTransition

_CLEAR = frozenset({"NORM", "RTNUN"})
_STATES: dict[str, AlarmState] = {state: state for state in STATES}
_KINDS: dict[str, AlarmKind] = {kind: kind for kind in get_args(AlarmKind)}


@dataclass(frozen=True, slots=True)
class AlarmRow:
    """One activation of an alarm, in the order of the columns of table `alarms`; figures as at raising."""

    seq: int
    run_id: int
    kind: str
    parameter: str
    priority: str
    state: str
    raised_ns: int
    cleared_ns: int | None
    acked_ns: int | None
    acked_by: str | None
    shelved_until_ns: int | None
    delta: float | None
    sd: float | None
    limit_value: float | None
    probability: float | None
    message: str

    @property
    def key(self) -> tuple[str, str]:
        return self.kind, self.parameter

    def cells(self) -> tuple[Cell, ...]:
        return tuple(getattr(self, name) for name in columns_of("alarms")[:-1])


class AlarmRows:
    """The alarms of one run that are not back to normal, by kind and parameter."""

    def __init__(self, run_id: int, standing: list[AlarmRow], outbox: Outbox) -> None:
        self._run_id, self._outbox = run_id, outbox
        self._open = {row.key: row for row in standing}

    def apply(self, plan: Plan, step: AlarmTransition, numbers: Numbers) -> None:
        """Add the event, and the alarm row as it is after it, to a plan.

        What the detector took for the alarm's state may be older than what an operator did since: the row's
        own counts.
        """
        row = self._open.get((step.kind, step.parameter))
        cause = cause_of(step.from_state, step.to_state)
        known = Alarm() if row is None else alarm_of(row)
        if cause is not None and is_needless(known, cause):
            return
        if row is not None:
            step = _as_it_is(row, step)
        is_new = step.to_state == "UNACK" and step.from_state in _CLEAR
        if row is None or is_new:  # an activation of its own
            row = self._raised(step, numbers)
            _annotate(plan, row, step, numbers)
        row = _after(row, step)
        self.take_up(row)
        plan.sealed("alarms", *row.cells())
        event_id = numbers.take("alarm_events")
        plan.sealed("alarm_events", event_id, row.seq, *event_cells(step))
        self._outbox.add(plan, event_id, step, numbers)

    def take_up(self, row: AlarmRow) -> None:
        """Go on with a row as it is now."""
        if row.state == "NORM":
            self._open.pop(row.key, None)
        else:
            self._open[row.key] = row

    @property
    def standing(self) -> list[AlarmRow]:
        """The rows that are not back to normal."""
        return list(self._open.values())

    def _raised(self, step: AlarmTransition, numbers: Numbers) -> AlarmRow:
        return AlarmRow(
            numbers.take("alarms"), self._run_id, step.kind, step.parameter, step.priority, step.to_state,
            step.t_ns, None, None, None, None, *_figures(step), step.message,
        )  # fmt: skip


def kind_of(row: AlarmRow) -> AlarmKind:
    """Return a row's kind; of another version's it is taken for a level."""
    return _KINDS.get(row.kind, "level")


def alarm_of(row: AlarmRow) -> Alarm:
    """Return what a row says of its alarm."""
    return Alarm(_STATES.get(row.state, "UNACK"), row.cleared_ns is None)


def detected(row: AlarmRow) -> AlarmState:
    """Return the state that a detector goes on with, which knows of conditions only."""
    suppressed: AlarmState = "UNACK" if row.cleared_ns is None else "NORM"
    return suppressed if row.state in SUPPRESSED else _STATES.get(row.state, suppressed)


def event_cells(step: AlarmTransition) -> tuple[Cell, ...]:
    """Return the columns of table `alarm_events` that a step says."""
    return step.t_ns, step.from_state, step.to_state, step.cause, step.by, step.comment


def _as_it_is(row: AlarmRow, step: AlarmTransition) -> AlarmTransition:
    """Return what a detector found as a step of the row's own state."""
    cause = cause_of(step.from_state, step.to_state)
    state = _STATES.get(row.state)
    if cause is None or state is None:
        return step
    stepped = alarm_of(row).step(cause)
    to = state if stepped is None else stepped.state
    return replace(step, from_state=state, to_state=to, cause=cause if state in SUPPRESSED else step.cause)


def _annotate(plan: Plan, row: AlarmRow, step: AlarmTransition, numbers: Numbers) -> None:
    if step.advice is not None or step.percent is not None:
        plan.sealed("annotations", numbers.take("annotations"), row.seq, step.advice, step.percent)


def _figures(step: AlarmTransition) -> tuple[float | None, float | None, float | None, float | None]:
    """Return delta, sd, limit and probability of a step; None where they are no numbers (NaN, inf)."""
    return finite(step.delta), finite(step.sd), finite(step.limit_value), finite(step.probability)


def _after(row: AlarmRow, step: AlarmTransition) -> AlarmRow:
    """Return the row as a transition leaves it."""
    row = replace(row, state=step.to_state)
    if step.to_state in SUPPRESSED and step.to_state == step.from_state:
        return _suppressed_after(row, step)
    if step.to_state in _CLEAR and row.cleared_ns is None:
        row = replace(row, cleared_ns=step.t_ns)
    if step.to_state == "UNACK":  # to be acknowledged again
        row = replace(row, acked_ns=None, acked_by=None)
    acknowledged = step.to_state == "ACKED" or (step.from_state, step.to_state) == ("RTNUN", "NORM")
    if acknowledged and row.acked_ns is None:
        row = replace(row, acked_ns=step.t_ns, acked_by=step.by)
    return row


def _suppressed_after(row: AlarmRow, step: AlarmTransition) -> AlarmRow:
    """Return a suppressed row as its condition leaves it: its state stays."""
    if step.cause == "raise" and row.cleared_ns is not None:
        delta, sd, limit, probability = _figures(step)
        row = replace(
            row, raised_ns=step.t_ns, delta=delta, sd=sd, limit_value=limit, probability=probability,
            message=step.message,
        )  # fmt: skip
    return replace(row, cleared_ns={"clear": step.t_ns, "raise": None}.get(step.cause, row.cleared_ns))


def standing_alarms(connection: sqlite3.Connection, rig: str, kind: str) -> list[AlarmRow]:
    """Return the newest activation of each of a rig's alarms not back to normal, over runs of one kind."""
    names = ", ".join(f"a.{name}" for name in columns_of("alarms")[:-1])
    query = (
        f"SELECT {names} FROM alarms a JOIN runs r ON r.seq = a.run_id JOIN rigs g ON g.seq = r.rig_id "
        "WHERE g.name = ? AND r.kind = ? ORDER BY a.seq"
    )
    newest = {row.key: row for row in (AlarmRow(*cells) for cells in connection.execute(query, (rig, kind)))}
    return [row for row in newest.values() if row.state != "NORM"]
