"""Which steps of alarms a target is notified of, and when."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime, timedelta

from agent.config import RigConfig
from agent.config.sections.results import PRIORITIES, Notify
from agent.types import AlarmTransition


def is_announced(step: AlarmTransition) -> bool:
    """Tell whether to notify of a step: not of a silenced alarm's condition, nor of what design does."""
    return step.from_state != step.to_state and "DSUPR" not in {step.from_state, step.to_state}


def concerns(target: Notify, step: AlarmTransition) -> bool:
    """Tell whether a target wants a step of this priority and kind."""
    wanted = target.kinds is None or step.kind in target.kinds
    return wanted and is_announced(step) and _rank(step.priority) >= _rank(target.priority)


def route(configs: Iterable[RigConfig], step: AlarmTransition) -> Sequence[str]:
    """Return the names of the targets that a step is for: those of its own rig's configuration."""
    targets: Mapping[str, tuple[Notify, ...]] = {config.rig.name: config.notify for config in configs}
    return [target.name for target in targets.get(step.rig, ()) if concerns(target, step)]


def quiet_s(target: Notify, now: datetime) -> float:
    """Return for how many seconds a target's quiet hours still last; 0 outside of them.

    now: local time.
    """
    if target.quiet is None:
        return 0.0
    first, last = target.quiet
    minute = now.hour * 60 + now.minute
    is_quiet = first <= minute < last if first < last else minute >= first or minute < last
    if not is_quiet:
        return 0.0
    end = now.replace(hour=last // 60, minute=last % 60, second=0, microsecond=0)
    return (end + timedelta(days=0 if end > now else 1) - now).total_seconds()


def _rank(priority: str) -> int:
    known: Sequence[str] = PRIORITIES
    return known.index(priority) if priority in known else len(known)
