"""An alarm as fields of an AlarmConditionType (OPC UA Part 9): what its ISA-18.2 state is called there."""

from collections.abc import Mapping
from typing import Any, Final

from asyncua import ua

from agent.cli.opcua.space import instant
from agent.storage.tuning import LONGEST_SHELF_NS

Row = Mapping[str, Any]
SEVERITIES: Final[Mapping[str, int]] = {"low": 250, "medium": 500, "high": 750, "critical": 1000}
_PROCESS: Final = frozenset({"level", "rate", "forecast"})
_SILENT: Final = ("Suppressed", "OutOfService", "Shelved")
_ACKED: Final = frozenset({"NORM", "ACKED"})


def states_of(alarm: Row) -> dict[str, bool]:
    """Return an alarm's two-state variables: Active, Acked, Confirmed, Suppressed, OutOfService, Shelved.

    A silenced alarm is active while its condition stands (nothing has cleared it) and acked if somebody did
    so before. The life cycle has one step by which somebody says that he knows, so Confirmed is as Acked.
    """
    state = alarm["state"]
    is_silent = state in {"SHLVD", "DSUPR", "OOSRV"}
    acked = alarm["acked_at"] is not None if is_silent else state in _ACKED
    return {
        "Active": alarm["cleared_at"] is None if is_silent else state in {"UNACK", "ACKED"},
        "Acked": acked, "Confirmed": acked, "Suppressed": state == "DSUPR", "OutOfService": state == "OOSRV",
        "Shelved": state == "SHLVD",
    }  # fmt: skip


_WORDS: Final[Mapping[str, tuple[str, str]]] = {
    "Active": ("Active", "Inactive"), "Acked": ("Acknowledged", "Unacknowledged"),
    "Confirmed": ("Confirmed", "Unconfirmed"), "Suppressed": ("Suppressed", "Unsuppressed"),
    "OutOfService": ("Out of Service", "In Service"),
}  # fmt: skip


def event_id(db: str, alarm: Row, step: int) -> bytes:
    """Return the id of a notification: of which alarm it is, and which of its steps it says."""
    return f"{db}/{alarm['id']}/{step}".encode()


def fields_of(alarm: Row, step: Row, places: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a condition by name, `State/Id` for what lies below one, as variants.

    Args:
        alarm: of v_alarms.
        step: `event_id`, `t_ns`, `by` and `comment` of its newest step.
        places: `condition`, `source` and `input`, ids of nodes; `name` of the source.
    """
    kinds = ua.VariantType
    state = states_of(alarm)
    of_class = "Process" if alarm["kind"] in _PROCESS else "System"
    class_id = ua.NodeId(getattr(ua.ObjectIds, f"{of_class}ConditionClassType"))
    severity = ua.Variant(SEVERITIES.get(alarm["priority"], 500), kinds.UInt16)
    time = ua.Variant(instant(step["t_ns"]), kinds.DateTime)
    found = {
        "EventId": ua.Variant(step["event_id"], kinds.ByteString),
        "EventType": ua.Variant(ua.NodeId(ua.ObjectIds.AlarmConditionType), kinds.NodeId),
        "SourceNode": ua.Variant(places["source"], kinds.NodeId),
        "InputNode": ua.Variant(places["input"], kinds.NodeId),
        "SourceName": ua.Variant(places["name"], kinds.String), "Time": time, "ReceiveTime": time,
        "Message": _text(_message(alarm)), "Severity": severity, "LastSeverity": severity,
        "ConditionClassId": ua.Variant(class_id, kinds.NodeId), "ConditionClassName": _text(of_class),
        "ConditionName": ua.Variant(f"{alarm['kind']} {alarm['parameter']}", kinds.String),
        "BranchId": ua.Variant(ua.NodeId(), kinds.NodeId),
        "Retain": ua.Variant(alarm["state"] != "NORM", kinds.Boolean),
        "Quality": ua.Variant(ua.StatusCode(ua.StatusCodes.Good), kinds.StatusCode),
        "Comment": _text(step["comment"] or ""), "ClientUserId": ua.Variant(step["by"] or "", kinds.String),
        "EnabledState": _text("Enabled"), "EnabledState/Id": ua.Variant(True, kinds.Boolean),
        "SuppressedOrShelved": ua.Variant(any(state[name] for name in _SILENT), kinds.Boolean),
        "MaxTimeShelved": ua.Variant(LONGEST_SHELF_NS / 1e6, kinds.Double),
        "ShelvingState/CurrentState": _text("TimedShelved" if state["Shelved"] else "Unshelved"),
    }  # fmt: skip
    for name, words in _WORDS.items():
        found[f"{name}State"] = _text(words[not state[name]])
        found[f"{name}State/Id"] = ua.Variant(state[name], kinds.Boolean)
    return found


def _text(words: str) -> Any:
    return ua.Variant(ua.LocalizedText(words), ua.VariantType.LocalizedText)


def _message(alarm: Row) -> str:
    return f"{alarm['message']}; {alarm['advice']}" if alarm["advice"] else str(alarm["message"])
