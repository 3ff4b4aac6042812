"""Alarm transitions as `deltak run` prints them: one line each on stderr, whatever is logged."""

import logging

from agent.alarms.life_cycle import SUPPRESSED
from agent.text import local_time, printable
from agent.types import AlarmTransition

log = logging.getLogger(__name__)
_ALARM = 35
"""Fixed by logging: a level above WARNING, 30, is always shown; shown as `alarm`: level of what is always
shown, and shown as `alarm`."""
logging.addLevelName(_ALARM, "ALARM")


def announce(step: AlarmTransition) -> None:
    """Log a transition at a level always shown; what a suppressed alarm's condition does is not announced."""
    if step.from_state == step.to_state and step.to_state in SUPPRESSED:
        return
    log.log(_ALARM, "%s", line_of(step))


def line_of(step: AlarmTransition) -> str:
    """Return a transition as one line: rig, priority, states, what, who and advice."""
    who = f" by {step.by}" if step.by else ""
    why = f" ({step.comment})" if step.comment else ""
    advice = f"; {step.advice}" if step.advice and step.to_state == "UNACK" else ""
    states = f"{step.from_state} -> {step.to_state}"
    words = f"{step.rig}: {step.priority} {step.kind} {states} at {local_time(step.t_ns)}: "
    return printable(" ".join(f"{words}{step.message}{who}{why}{advice}".split()))
