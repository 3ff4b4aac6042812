"""Watching the watcher: alarms of parameters not estimated, and of models that explain the machine no more.

A parameter with an alarm that got no valid row for its time is blind, whatever its readings say: a fault from
the first sample on, or one that comes and goes faster than a window, is not silent. Time counts sample
indices, from row to row, so what a source did not deliver (which has an alarm of its own) is no time.
Parameters that go blind for one reason share one alarm; the reason `mismatch` is the model's, and its alarm
of another kind. A valid row clears, nothing else.

A row at a standstill is no fault: it is no time either, unless the configuration names a time (`blind_s`). A
row that is unexcited though the machine moves counts: a model that does not fit widens intervals before
anything else.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from agent.blocks.tuning import BLIND_S, BLIND_WINDOWS
from agent.config.tables import Alarm as AlarmRule
from agent.numerics.preprocessing.rows import steps_from
from agent.types import AlarmKind, AlarmTransition, BoolArray, EstimateBatch, Reason, Status

BLIND_KINDS: Final[tuple[AlarmKind, ...]] = ("blind", "mismatch")
MODEL: Final = "model"
"""What alarms of kind mismatch are of."""
_OF_CHANNELS: Final = frozenset(
    {Reason.SENSOR, Reason.STUCK, Reason.SATURATED, Reason.NO_DATA, Reason.INSEPARABLE}
)
"""Reasons that an alarm of a channel explains, where one stands."""


@dataclass(slots=True)
class _Watch:
    """One parameter: for how many samples it has not been estimated, by reason."""

    rule: AlarmRule
    window_s: float
    samples: Counter[str] = field(default_factory=Counter)

    def due_s(self) -> float:
        return self.rule.blind_s or max(BLIND_S, BLIND_WINDOWS * self.window_s)

    @property
    def prevailing(self) -> str:
        return max(self.samples, key=lambda reason: self.samples[reason])


@dataclass(slots=True)
class _Group:
    """One alarm that stands, and the parameters that share it; reason None where an earlier run raised it."""

    kind: AlarmKind
    parameter: str
    priority: str
    reason: str | None
    members: set[str]


class BlindAlarms:
    """The alarms of kinds `blind` and `mismatch` of one rig.

    Args:
        rig: its name.
        rules: the configuration's alarm tables; of several of one parameter the first counts.
        sample_rate_hz: turns samples into seconds.
        window_s: of the shortest window, until rows say theirs.
    """

    def __init__(self, rig: str, rules: Sequence[AlarmRule], sample_rate_hz: float, window_s: float) -> None:
        self._rig, self._rate = rig, sample_rate_hz
        self._watches = {rule.parameter: _Watch(rule, window_s) for rule in reversed(rules)}
        self._names = list(dict.fromkeys(rule.parameter for rule in rules))
        self._groups: list[_Group] = []
        self._index: int | None = None

    def restore(self, standing: Iterable[tuple[AlarmKind, str, str]]) -> None:
        """Go on with the alarms that the run before left standing: kind, parameter, priority."""
        for kind, parameter, priority in standing:
            members = set(self._names) if kind == "mismatch" else {parameter} & set(self._names)
            if members:
                self._groups.append(_Group(kind, parameter, priority, None, members))

    def step(self, batch: EstimateBatch, *, explained: bool = False) -> list[AlarmTransition]:
        """Return what rows change, in order of time. explained: a channel's alarm stands."""
        if not self._names or not len(batch):
            return []
        columns = [batch.parameters.index(name) for name in self._names]
        before = int(batch.index[0]) if self._index is None else self._index
        self._index = int(batch.index[-1])
        found: list[AlarmTransition] = []
        steps = steps_from(before, batch.index)
        for row in _changing(batch.status[:, columns] == Status.VALID):
            found += self._row(batch, row, columns, int(steps[row]), explained=explained)
        return found

    def _row(
        self, batch: EstimateBatch, row: int, columns: Sequence[int], passed: int, *, explained: bool
    ) -> list[AlarmTransition]:
        due: list[str] = []
        seen: set[str] = set()
        for name, column in zip(self._names, columns, strict=True):
            watch = self._watches[name]
            window_s = float(batch.window_s[row, column])
            watch.window_s = window_s if window_s > 0 else watch.window_s
            reason = _reason(batch, row, column)
            if reason is None:
                seen.add(name)
                watch.samples.clear()
            elif _counts(watch.rule, batch, (row, column), explained=explained):
                longest = max(1, round(watch.window_s * self._rate))
                watch.samples[reason] += min(max(0, passed), longest)
                due += [name] if watch.samples.total() >= watch.due_s() * self._rate else []
        t_ns = int(batch.t_ns[row])
        return self._clear(seen, t_ns) + self._raise(due, t_ns)

    def _clear(self, seen: set[str], t_ns: int) -> list[AlarmTransition]:
        """Take parameters that are estimated again out of their alarms; one without any is over."""
        for group in self._groups:
            group.members -= seen
        over = [group for group in self._groups if not group.members]
        self._groups = [group for group in self._groups if group.members]
        return [self._transition(group, t_ns, _over_words(group), stands=False) for group in over]

    def _raise(self, due: Sequence[str], t_ns: int) -> list[AlarmTransition]:
        """Raise one alarm for all parameters due for one reason, unless one stands that they join."""
        standing = {name for group in self._groups for name in group.members}
        fresh: dict[str, list[str]] = {}
        for name in due:
            if name not in standing:
                fresh.setdefault(self._watches[name].prevailing, []).append(name)
        return [raised for reason, names in fresh.items() for raised in self._raise_one(reason, names, t_ns)]

    def _raise_one(self, reason: str, names: list[str], t_ns: int) -> list[AlarmTransition]:
        kind: AlarmKind = "mismatch" if reason == "mismatch" else "blind"
        for group in self._groups:
            if group.kind == kind and group.reason in {None, reason}:
                group.members |= set(names)
                return []
        first = self._watches[names[0]]
        group = _Group(
            kind, MODEL if kind == "mismatch" else names[0], first.rule.priority, reason, set(names)
        )
        self._groups.append(group)
        words = self._words(kind, reason, names, first.samples.total() / self._rate)
        return [self._transition(group, t_ns, words, stands=True, advice=first.rule.advice)]

    @staticmethod
    def _words(kind: AlarmKind, reason: str, names: Sequence[str], seconds: float) -> str:
        listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
        if kind == "mismatch":
            return (
                f"the model has not explained the machine for {seconds:.0f} s: no valid estimate of {listed}"
            )
        return f"no valid estimate of {listed} for {seconds:.0f} s, most often for the reason {reason}"

    def _transition(
        self, group: _Group, t_ns: int, words: str, *, stands: bool, advice: str | None = None
    ) -> AlarmTransition:
        return AlarmTransition.plain(
            self._rig, group.kind, group.parameter, t_ns, words, stands=stands, priority=group.priority,
            advice=advice,
        )  # fmt: skip


def _changing(valid: BoolArray) -> list[int]:
    """Return the rows (N, c) that may change something: not those amid rows in which all is valid."""
    odd = np.asarray(~valid.all(axis=1))
    beside = odd.copy()
    beside[1:] |= odd[:-1]
    beside[:-1] |= odd[1:]
    beside[[0, -1]] = True
    return list(np.flatnonzero(beside).tolist())


def _over_words(group: _Group) -> str:
    if group.kind == "mismatch":
        return "the model explains the machine again"
    return f"{group.parameter} and what shared its alarm are estimated again"


def _reason(batch: EstimateBatch, row: int, column: int) -> str | None:
    """Return why a row has no valid estimate; None where it has one."""
    status = Status(int(batch.status[row, column]))
    if status == Status.VALID:
        return None
    reason = Reason(int(batch.reason[row, column]))
    return (status if reason == Reason.NONE else reason).name.lower().replace("_", " ")


def _counts(rule: AlarmRule, batch: EstimateBatch, place: tuple[int, int], *, explained: bool) -> bool:
    """Tell whether a row without a valid estimate is time that a parameter is blind."""
    reason = Reason(int(batch.reason[place]))
    if reason == Reason.STANDSTILL:
        return rule.blind_s is not None
    return not (explained and reason in _OF_CHANNELS)
