"""Rows as metrics of a device, the rig: `<parameter>/value`, `Alarms/<parameter>/state` and so on."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from agent.northbound.interface.peer import Row
from agent.northbound.sparkplug.payload import DOUBLE, INT64, STRING, Metric, Value

_COLUMNS: Final[Mapping[str, Mapping[str, tuple[str, int]]]] = {
    "estimates": {
        "value": ("value", DOUBLE), "sd": ("sd", DOUBLE), "lower": ("lower", DOUBLE),
        "upper": ("upper", DOUBLE),
        "delta": ("delta", DOUBLE), "status": ("status", STRING), "reason": ("reason", STRING),
        "seq": ("seq", INT64),
    },
    "alarms": {
        "state": ("to_state", STRING), "cause": ("cause", STRING), "priority": ("priority", STRING),
        "message": ("message", STRING), "seq": ("seq", INT64),
    },
    "events": {"cause": ("cause", STRING), "message": ("message", STRING), "seq": ("seq", INT64)},
    "health": {
        "received": ("received", INT64), "used": ("used", INT64), "rejected": ("rejected", INT64),
        "dropped": ("dropped", INT64), "gaps": ("gaps", INT64), "lag_s": ("lag_s", DOUBLE),
        "seq": ("seq", INT64),
    },
}  # fmt: skip
"""By topic: the last part of a metric's name, the column that it is of, and its data type."""
_WITH_UNIT: Final = ("value", "sd", "lower", "upper", "delta")
_FOLDER: Final = {"estimates": "", "alarms": "Alarms/", "events": "Events/", "health": "Health/"}


class Reading(NamedTuple):
    """A metric of a device, without alias."""

    name: str
    datatype: int
    value: Value
    t_ms: int
    unit: str


def readings(topic: str, row: Row) -> Iterator[Reading]:
    """Yield what a row says, metric by metric."""
    of = row["parameter"] if topic in {"estimates", "alarms"} else row["source"]
    for last, (column, datatype) in _COLUMNS[topic].items():
        has_unit = topic == "estimates" and last in _WITH_UNIT
        unit = str(row["unit"]) if has_unit else ""
        yield Reading(
            f"{_FOLDER[topic]}{of}/{last}", datatype, _finite(row[column]), row["t_ns"] // 1_000_000, unit
        )


def _finite(value: Any) -> Any:
    is_number = isinstance(value, float)
    return None if is_number and not math.isfinite(value) else value


class Device:
    """What was born of one rig: its metrics by name, each with its present reading and alias."""

    def __init__(self) -> None:
        self.known: dict[str, tuple[int, Reading]] = {}
        self.is_due = False
        """Whether it has metrics that were not born yet."""

    def learn(self, reading: Reading, alias: int, *, historical: bool) -> bool:
        """Take up a reading; tell whether its metric is new, and so the device is to be born anew."""
        is_new = reading.name not in self.known
        if is_new:
            present = reading._replace(value=None) if historical else reading
            self.known[reading.name] = (alias, present)
        elif not historical:
            self.known[reading.name] = (self.known[reading.name][0], reading)
        return is_new

    def birth(self) -> list[Metric]:
        """Return all metrics, as a birth has them."""
        return [
            Metric(r.datatype, r.value, r.t_ms, name=r.name, alias=alias, unit=r.unit)
            for alias, r in self.known.values()
        ]

    def data(self, reading: Reading, *, historical: bool) -> Metric:
        """Return a reading as data have it: by alias."""
        alias, _ = self.known[reading.name]
        return Metric(reading.datatype, reading.value, reading.t_ms, alias=alias, historical=historical)
