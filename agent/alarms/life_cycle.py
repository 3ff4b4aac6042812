# ruff: noqa: E501 - the table
"""The life cycle of an alarm: one total table, state x cause -> state (ANSI/ISA-18.2-2016 and IEC 62682, clause 5.4).

Clause 5.4 draws the states A to I and the arrows between them; E and F are of latching alarms, which there
are none of here. To G by the operator and for a limited time, to H by the design of the system, to I by
whoever maintains it; from each of them back to what the condition is then. Where the diagram leaves open in
what state an alarm comes back, the table says it: a shelf that the operator ends is ACKED, one that ends by
itself UNACK. OPC UA Part 9 has the same as variables and methods (AcknowledgeableConditionType,
AlarmConditionType, ShelvedStateMachineType 5.8.17).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, get_args

from agent.types import AlarmState

Cause = Literal[
    "raise", "clear", "acknowledge", "shelve", "unshelve", "expire", "suppress", "unsuppress", "out of service",
    "return", "re-alarm",
]  # fmt: skip
STATES: Final[tuple[AlarmState, ...]] = get_args(AlarmState)
CAUSES: Final[tuple[Cause, ...]] = get_args(Cause)
COMMANDS: Final[tuple[Cause, ...]] = ("acknowledge", "shelve", "unshelve", "out of service", "return")
"""What an operator does; the others happen by themselves."""
SUPPRESSED: Final = frozenset[AlarmState]({"SHLVD", "DSUPR", "OOSRV"})
"""States in which nothing is announced, whatever the condition does."""
RAISED: Final[Mapping[AlarmState, AlarmState]] = {"NORM": "UNACK", "RTNUN": "UNACK"}
CLEARED: Final[Mapping[AlarmState, AlarmState]] = {"UNACK": "RTNUN", "ACKED": "NORM"}
"""What a detector, which knows of conditions only, makes of a state by raising and by clearing."""

TABLE: Final = """
state  raise  clear  acknowledge  shelve  unshelve    expire      suppress  unsuppress  out-of-service  return      re-alarm
NORM   UNACK  -      x            SHLVD   x           -           DSUPR     -           OOSRV           x           -
UNACK  -      RTNUN  ACKED        SHLVD   x           -           DSUPR     -           OOSRV           x           -
ACKED  -      NORM   x            SHLVD   x           -           DSUPR     -           OOSRV           x           UNACK
RTNUN  UNACK  -      NORM         SHLVD   x           -           DSUPR     -           OOSRV           x           -
SHLVD  -      -      x            x       ACKED/NORM  UNACK/NORM  -         -           OOSRV           x           -
DSUPR  -      -      x            SHLVD   x           -           -         UNACK/NORM  OOSRV           x           -
OOSRV  -      -      x            x       x           -           -         -           x               UNACK/NORM  -
""".strip()
"""A cell: the state after; "-": stays as it is; "x": refused; "P/Q": P where the condition stands, else Q."""

_MEANING: Final[Mapping[AlarmState, tuple[str, str, str]]] = {
    "NORM": ("A", "nothing", "ActiveState false, AckedState true"),
    "UNACK": ("B", "the condition stands, nobody has acknowledged it", "ActiveState true, AckedState false"),
    "ACKED": ("C", "the condition stands, somebody knows", "ActiveState true, AckedState true"),
    "RTNUN": (
        "D",
        "the condition is over, nobody has acknowledged it",
        "ActiveState false, AckedState false",
    ),
    "SHLVD": ("G", "silenced by the operator for a limited time", "ShelvingState TimedShelved"),
    "DSUPR": ("H", "silenced by the design of the system", "SuppressedState true"),
    "OOSRV": ("I", "out of service until it is returned", "OutOfServiceState true"),
}
_RULES: Final[Mapping[Cause, tuple[str, str]]] = {
    "raise": ("5.4: A to B, D to B", "the condition has held for its on-delay; a new activation"),
    "clear": (
        "5.4: B to D, C to A",
        "the condition has been over for its off-delay; missing data never clears",
    ),
    "acknowledge": ("5.4: B to C, D to A", "deltak ack; Acknowledge"),
    "shelve": ("5.4 to G", "deltak shelve --for; TimedShelve, at most MaxTimeShelved"),
    "unshelve": ("5.4 from G", "deltak unshelve: whoever ends it knows of the alarm, so ACKED; Unshelve"),
    "expire": ("5.4 from G", "the time is over and nobody looks: UNACK; TimeExpired"),
    "suppress": ("5.4 to H", "by design; Suppress"),
    "unsuppress": ("5.4 from H", "by design; Unsuppress"),
    "out of service": ("5.4 to I", "deltak oos; RemoveFromService"),
    "return": ("5.4 from I", "deltak return; PlaceInService"),
    "re-alarm": ("5.4: C to B", "acknowledged for re_alarm_s, and the condition stands; ReAlarmTime"),
}


def _parsed() -> dict[tuple[AlarmState, Cause], str]:
    rows = [line.split() for line in TABLE.splitlines()]
    return {(state, cause): cell for state, row in zip(STATES, rows[1:], strict=True)
            for cause, cell in zip(CAUSES, row[1:], strict=True)}  # fmt: skip


_CELLS: Final = _parsed()
_BY_NAME: Final[Mapping[str, AlarmState]] = {state: state for state in STATES}


def after(state: AlarmState, cause: Cause, *, stands: bool) -> AlarmState | None:
    """Return the state that a cause leads to; None where it is refused and nothing changes.

    stands: whether the condition does, once the cause is taken into account.
    """
    cell = _CELLS[state, cause]
    if cell == "x":
        return None
    active, _, normal = cell.partition("/")
    return _BY_NAME.get(active if stands or not normal else normal, state)


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm: its state, and whether its condition stands, which suppressed states do not tell."""

    state: AlarmState = "NORM"
    stands: bool = False

    def step(self, cause: Cause) -> "Alarm | None":
        """Return the alarm after a cause; None where it is refused."""
        stands = cause == "raise" or (self.stands and cause != "clear")
        state = after(self.state, cause, stands=stands)
        return None if state is None else Alarm(state, stands)


def cause_of(before: AlarmState, to: AlarmState) -> Cause | None:
    """Return what a detector means by a step that it made of what it knew; None for no step of the process's."""
    if "DSUPR" in {before, to}:
        return "suppress" if to == "DSUPR" else "unsuppress"
    if to == "UNACK" and before in {"NORM", "RTNUN"}:
        return "raise"
    if (before, to) == ("ACKED", "UNACK"):
        return "re-alarm"
    return "clear" if (before, to) in {("UNACK", "RTNUN"), ("ACKED", "NORM")} else None


def is_needless(alarm: Alarm, cause: Cause) -> bool:
    """Tell whether design has nothing to do with an alarm: only one that stands is silenced, and speaks again."""
    silences = cause == "suppress" and not alarm.stands
    return silences or (cause == "unsuppress" and alarm.state != "DSUPR")


def legend() -> list[tuple[str, str, str, str]]:
    """Return each state with its letter in clause 5.4, its meaning, and its name in OPC UA Part 9."""
    return [(state, *_MEANING[state]) for state in STATES]


def rules() -> list[tuple[str, str, str]]:
    """Return each cause with its clause and what brings it about."""
    return [(cause, *_RULES[cause]) for cause in CAUSES]
