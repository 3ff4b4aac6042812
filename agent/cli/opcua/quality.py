"""What an estimate is worth in OPC UA's words: the value given, its instant, a status code (Part 8, 6.3)."""

from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from agent.cli.tuning import STALE_S

Row = Mapping[str, Any]
GOOD: Final = "Good"
OUT_OF_REACH: Final = "UncertainNoCommunicationLastUsableValue"
_BAD: Final[Mapping[str | None, str]] = {
    "sensor": "BadSensorFailure",
    "stuck": "BadSensorFailure",
    "saturated": "BadSensorFailure",
    "no data": "BadNoCommunication",
    "gap": "BadNoCommunication",
}


class Quality(NamedTuple):
    """The value that clients get, None for none; its instant, ns; the name of its status code."""

    value: float | None
    t_ns: int
    code: str


def quality_of(row: Row, now_ns: int) -> Quality:
    """Return what a row of v_latest says to a client.

    valid is Good, and uncertain (last usable value, nobody communicates) once the row is older than STALE_S.
    Where it is not valid the last valid value is given with its own instant, uncertain; without one a window
    that does not resolve the parameter gives its own value as sub-normal, and all else is bad.
    """
    if row["status"] == "valid":
        is_old = (now_ns - row["t_ns"]) / 1e9 > STALE_S
        return Quality(row["value"], row["t_ns"], OUT_OF_REACH if is_old else GOOD)
    if row["held"] is not None:
        t_ns = row["t_ns"] - round((row["held_age_s"] or 0.0) * 1e9)
        return Quality(row["held"], t_ns, "UncertainLastUsableValue")
    if row["status"] == "unexcited" and row["value"] is not None:
        return Quality(row["value"], row["t_ns"], "UncertainSubNormal")
    waits = row["status"] == "warming"
    return Quality(None, row["t_ns"], "BadWaitingForInitialData" if waits else _BAD.get(row["reason"], "Bad"))


def own_code(row: Row, now_ns: int) -> str:
    """Return the status code of what belongs to the newest window itself: its interval, sd, change."""
    if row["value"] is None:
        return quality_of({**row, "held": None}, now_ns).code
    found = quality_of({**row, "held": None}, now_ns).code
    return found if found in {GOOD, OUT_OF_REACH} else "UncertainSubNormal"
