"""Advisory: an acknowledged alarm that stands for long after asks again (ISA-18.2 clause 5.4: C to B)."""

from collections.abc import Iterable, Mapping, Sequence

from agent.alarms.life_cycle import Alarm
from agent.config.tables import Alarm as AlarmRule
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
