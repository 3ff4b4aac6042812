"""The tables that rows go to: columns and their types, as they are made where they are not there."""

from typing import Final

_TEXT = "text"
_WHOLE = "bigint"
_REAL = "double precision"
_TIME: Final = {"t_ns": f"{_WHOLE} NOT NULL", "time": "timestamptz NOT NULL"}
_KEY: Final = {"rig": f"{_TEXT} NOT NULL", "seq": f"{_WHOLE} NOT NULL"}
_LAST: Final = {"backfill": "boolean NOT NULL"}

COLUMNS: Final[dict[str, dict[str, str]]] = {
    "estimates": _KEY | _TIME | {
        "run_id": _WHOLE, "parameter": _TEXT, "unit": _TEXT, "value": _REAL, "delta": _REAL,
        "reference": _REAL,
        "baseline_id": _WHOLE, "sd": _REAL, "lower": _REAL, "upper": _REAL, "status": _TEXT, "reason": _TEXT,
        "held": _REAL, "held_age_s": _REAL, "window_s": _REAL, "n_used": _WHOLE, "n_missing": _WHOLE,
        "span_s": _WHOLE, "method": _TEXT, "sd_repeat": _REAL,
    } | _LAST,
    "alarms": _KEY | _TIME | {
        "alarm_id": _WHOLE, "from_state": _TEXT, "to_state": _TEXT, "cause": _TEXT, "by": _TEXT,
        "comment": _TEXT,
        "kind": _TEXT, "parameter": _TEXT, "priority": _TEXT, "message": _TEXT, "delta": _REAL, "sd": _REAL,
        "limit_value": _REAL, "probability": _REAL,
    } | _LAST,
    "events": _KEY | _TIME | {"source": _TEXT, "cause": _TEXT, "message": _TEXT} | _LAST,
    "health": _KEY | _TIME | {
        "source": _TEXT, "received": _WHOLE, "used": _WHOLE, "rejected": _WHOLE, "dropped": _WHOLE,
        "gaps": _WHOLE,
        "lag_s": _REAL, "drift_ppm": _REAL, "drift_sd_ppm": _REAL, "skew_s": _REAL, "skew_sd_s": _REAL,
    } | _LAST,
}  # fmt: skip
"""Columns by topic, of the views that rows come from, in the order in which they are copied."""
NAMES: Final = {"estimates": "estimates", "alarms": "alarm_events", "events": "events", "health": "health"}
"""What the tables are called behind the prefix."""
STEADY: Final = ("estimates", "alarms", "events")
"""Topics whose rows never change: the same rig and seq with another time is a row of another database."""
