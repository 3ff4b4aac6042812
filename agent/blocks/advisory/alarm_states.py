"""Advisory: alarm states of a running rig. Detectors say what the process did, operators what they want.

The store decides each step once more from the row that it holds, so where a command and the process cross,
both take the same two causes and come to the same state.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from agent.alarms.life_cycle import Alarm, Cause, cause_of, is_needless
from agent.config.tables import Alarm as AlarmRule
from agent.records import Record
from agent.types import AlarmKind, AlarmTransition


class ReAlarms:
    """The alarms of one rig that ask again. Time is monotonic, from the agent's start at the earliest."""

    def __init__(self, rig: str, rules: Sequence[AlarmRule]) -> None:
        self._rig = rig
        self._rules: Mapping[str, AlarmRule] = {rule.parameter: rule for rule in rules if rule.re_alarm_s}
        self._since: dict[tuple[AlarmKind, str], int] = {}

    def step(
        self, alarms: Iterable[tuple[AlarmKind, str, Alarm]], now_ns: int, t_ns: int
    ) -> list[AlarmTransition]:
        """Return who asks again: alarms by kind and parameter; now_ns monotonic, t_ns the time of steps."""
        if not self._rules:
            return []
        acked = [
            (kind, name) for kind, name, alarm in alarms if alarm.state == "ACKED" and name in self._rules
        ]
        self._since = {key: self._since.get(key, now_ns) for key in acked}
        due = [key for key, since in self._since.items() if now_ns - since >= self._length_ns(key[1])]
        return [self._asks(kind, name, t_ns) for kind, name in due]

    def _length_ns(self, parameter: str) -> float:
        return 1e9 * (self._rules[parameter].re_alarm_s or 0.0)

    def _asks(self, kind: AlarmKind, parameter: str, t_ns: int) -> AlarmTransition:
        rule = self._rules[parameter]
        words = f"{parameter}: acknowledged {rule.re_alarm_s:g} s ago and not over"
        return AlarmTransition(
            rig=self._rig, kind=kind, parameter=parameter, priority=rule.priority, t_ns=t_ns,
            from_state="ACKED", to_state="UNACK", cause="re-alarm", message=words, advice=rule.advice,
        )  # fmt: skip


class AlarmStates:
    """The alarms of one rig by kind and parameter; those not named are NORM."""

    def __init__(self) -> None:
        self._alarms: dict[tuple[AlarmKind, str], Alarm] = {}

    def restore(self, standing: Iterable[tuple[AlarmKind, str, Alarm]]) -> None:
        """Go on with the alarms of an earlier run: kind, parameter, and what it is."""
        self._alarms = {(kind, parameter): alarm for kind, parameter, alarm in standing}

    def all(self) -> list[tuple[AlarmKind, str, Alarm]]:
        """Return the alarms that ever left NORM: kind, parameter, and what it is."""
        return [(kind, parameter, alarm) for (kind, parameter), alarm in self._alarms.items()]

    def __getitem__(self, key: tuple[AlarmKind, str]) -> Alarm:
        return self._alarms.get(key, Alarm())

    def step(self, records: Sequence[Record]) -> list[Record]:
        """Return records with alarm steps as the states have them; what an operator silenced stays silent."""
        return [step for record in records for step in self._stepped(record)]

    def _stepped(self, found: Record) -> list[Record]:
        if not isinstance(found, AlarmTransition):
            return [found]
        cause = cause_of(found.from_state, found.to_state)
        if cause is None:
            return [found]
        if is_needless(self[found.kind, found.parameter], cause):
            return []
        before, after = self._go(found, cause)
        return [replace(found, from_state=before.state, to_state=after.state)]

    def take_up(self, step: AlarmTransition, cause: Cause) -> None:
        """Take up what was done to an alarm and is stored; what its state refuses by now is left."""
        self._go(step, cause)

    def _go(self, step: AlarmTransition, cause: Cause) -> tuple[Alarm, Alarm]:
        before = self[step.kind, step.parameter]
        after = before.step(cause) or before
        self._alarms[step.kind, step.parameter] = after
        return before, after
