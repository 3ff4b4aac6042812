"""When a rig's forecasts are due: at equal times, and where one of its level alarms changes."""

import math
from collections.abc import Iterable

from agent.records import Record
from agent.runtime.tuning import ALARM_FORECASTS, FORECASTS_AT_ONCE
from agent.types import AlarmTransition

DUE, ALARM = "due", "alarm"


class Schedule:
    """Instants of one clock, ns: of samples in a replay, monotonic while the agent runs.

    every_s: may be infinite. first_s: until the first, where that is sooner, so that short runs forecast too.
    """

    def __init__(self, every_s: float, first_s: float = math.inf) -> None:
        self._first_ns = round(min(every_s, first_s) * 1e9) if not math.isinf(every_s) else 0
        self._every_ns = None if math.isinf(every_s) else round(every_s * 1e9)
        self._apart_ns = 60_000_000_000 if self._every_ns is None else self._every_ns // ALARM_FORECASTS
        self._due_ns: int | None = None
        self._alarmed: dict[str, int] = {}

    def due(self, now_ns: int) -> list[int]:
        """Return instants up to now when forecasts are due; the first is one time after the first call."""
        if self._every_ns is None:
            return []
        if self._due_ns is None:
            self._due_ns = now_ns + self._first_ns
        count = max(0, (now_ns - self._due_ns) // self._every_ns + 1)
        first, self._due_ns = self._due_ns, self._due_ns + count * self._every_ns
        return [first + i * self._every_ns for i in range(max(0, count - FORECASTS_AT_ONCE), count)]

    def at_alarms(self, records: Iterable[Record], now_ns: int | None = None) -> list[tuple[int, str]]:
        """Return when level alarms changed, and of what; not those that changed a moment ago as well."""
        found = []
        steps = [
            record for record in records if isinstance(record, AlarmTransition) and record.kind == "level"
        ]
        for step in steps:
            at = step.t_ns if now_ns is None else now_ns
            before = self._alarmed.get(step.parameter)
            if before is None or at - before >= self._apart_ns:
                self._alarmed[step.parameter] = at
                found.append((step.t_ns, step.parameter))
        return found
