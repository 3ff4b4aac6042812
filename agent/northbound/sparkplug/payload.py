"""Sparkplug's payload: metrics with their time, as message org.eclipse.tahu.protobuf.Payload."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from agent.northbound.sparkplug.wire import block, fields, real, whole

INT64: Final = 4
DOUBLE: Final = 10
BOOLEAN: Final = 11
STRING: Final = 12
"""Data types of metrics, as the specification numbers them."""
_PAYLOAD: Final = {"timestamp": 1, "metrics": 2, "seq": 3}
_METRIC: Final = {
    "name": 1, "alias": 2, "timestamp": 3, "datatype": 4, "is_historical": 5, "is_null": 7, "properties": 9,
}  # fmt: skip
_VALUE: Final = {INT64: 11, DOUBLE: 13, BOOLEAN: 14, STRING: 15}
_KEYS, _VALUES, _TYPE, _TEXT = 1, 2, 1, 8

Value = int | float | bool | str | None


@dataclass(frozen=True, slots=True)
class Metric:
    """One value.

    Attributes:
        datatype: one of those above.
        value: None for null.
        t_ms: when it was so, ms since the epoch.
        name: given in births, and where there is no alias.
        alias: the number that stands for the name after a birth.
        historical: whether it is not the present value.
        unit: given in births; "" for none.
    """

    datatype: int
    value: Value
    t_ms: int
    name: str | None = None
    alias: int | None = None
    historical: bool = False
    unit: str = ""

    def encode(self) -> bytes:
        """Return the metric as a message."""
        out = b"" if self.name is None else block(_METRIC["name"], self.name.encode())
        out += b"" if self.alias is None else whole(_METRIC["alias"], self.alias)
        out += whole(_METRIC["timestamp"], self.t_ms) + whole(_METRIC["datatype"], self.datatype)
        out += whole(_METRIC["is_historical"], 1) if self.historical else b""
        return (
            out + self._value() + (block(_METRIC["properties"], _properties(self.unit)) if self.unit else b"")
        )

    def _value(self) -> bytes:
        if self.value is None:
            return whole(_METRIC["is_null"], 1)
        field = _VALUE[self.datatype]
        if self.datatype == STRING:
            return block(field, str(self.value).encode())
        return real(field, float(self.value)) if self.datatype == DOUBLE else whole(field, int(self.value))


def encode(metrics: Sequence[Metric], t_ms: int | None = None, seq: int | None = None) -> bytes:
    """Return a payload: of a death without time and seq."""
    out = b"" if t_ms is None else whole(_PAYLOAD["timestamp"], t_ms)
    out += b"".join(block(_PAYLOAD["metrics"], metric.encode()) for metric in metrics)
    return out + (b"" if seq is None else whole(_PAYLOAD["seq"], seq))


def commands(payload: bytes) -> dict[str, bool]:
    """Return the metric names of a host's payload, and whether each is true. Raises ValueError."""
    found = {}
    for number, content in fields(payload):
        if number == _PAYLOAD["metrics"] and isinstance(content, bytes):
            metric = dict(fields(content))
            name = metric.get(_METRIC["name"], b"")
            if isinstance(name, bytes):
                found[name.decode(errors="replace")] = metric.get(_VALUE[BOOLEAN]) == 1
    return found


def _properties(unit: str) -> bytes:
    value = whole(_TYPE, STRING) + block(_TEXT, unit.encode())
    return block(_KEYS, b"engUnit") + block(_VALUES, value)
