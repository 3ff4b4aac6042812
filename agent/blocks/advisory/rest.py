"""Suppression by design (ISA-18.2 clause 5.4, state H): what stands is silent while the machine rests.

Where `at_rest = "suppress"`, a part that the motion has not resolved (`unexcited`) for ten seconds says
nothing: its level alarm is DSUPR, whatever was acknowledged, and asks again with the first valid row. An
alarm that does not stand is left: rows that are not valid raise nothing.
"""

from collections.abc import Sequence

from agent.blocks.tuning import REST_S
from agent.config.tables import Alarm as AlarmRule
from agent.numerics.preprocessing.rows import steps_from
from agent.types import AlarmState, AlarmTransition, EstimateBatch, Status


class RestAlarms:
    """The level alarms of one rig that rest silences; cutting a batch in two changes nothing."""

    def __init__(self, rig: str, rules: Sequence[AlarmRule], sample_rate_hz: float) -> None:
        self._rig = rig
        self._rules = {rule.parameter: rule for rule in rules if rule.at_rest == "suppress"}
        self._due = REST_S * sample_rate_hz
        self._rested = dict.fromkeys(self._rules, 0)
        self._silent: set[str] = set()
        self._index: int | None = None

    def step(self, batch: EstimateBatch) -> list[AlarmTransition]:
        """Return who is silenced and who speaks again, in order of time."""
        if not self._rules or not len(batch):
            return []
        columns = {name: batch.parameters.index(name) for name in self._rules}
        steps = steps_from(int(batch.index[0]) if self._index is None else self._index, batch.index)
        self._index = int(batch.index[-1])
        rows = range(len(batch))
        found = [self._row(name, int(batch.status[row, column]), int(steps[row]), int(batch.t_ns[row]))
                 for row in rows for name, column in columns.items()]  # fmt: skip
        return [step for steps_ in found for step in steps_]

    def restore(self, silent: Sequence[str]) -> None:
        """Go on with the parameters that were silent when the run before ended."""
        self._silent = set(silent) & set(self._rules)

    def _row(self, name: str, status: int, passed: int, t_ns: int) -> list[AlarmTransition]:
        if status == Status.VALID:
            self._rested[name] = 0
            speaks = name in self._silent
            self._silent.discard(name)
            return [self._step(name, "DSUPR", "UNACK", t_ns)] if speaks else []
        if status != Status.UNEXCITED or name in self._silent:
            return []
        self._rested[name] += max(0, passed)
        if self._rested[name] < self._due:
            return []
        self._silent.add(name)
        return [self._step(name, "UNACK", "DSUPR", t_ns)]

    def _step(self, name: str, before: AlarmState, after: AlarmState, t_ns: int) -> AlarmTransition:
        rests = after == "DSUPR"
        return AlarmTransition(
            rig=self._rig, kind="level", parameter=name, priority=self._rules[name].priority, t_ns=t_ns,
            from_state=before, to_state=after, cause="suppress" if rests else "unsuppress",
            message=f"{name}: the machine {'rests' if rests else 'moves again'}",
        )  # fmt: skip
