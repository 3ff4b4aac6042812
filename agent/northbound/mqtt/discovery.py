"""Home Assistant's MQTT discovery: a sensor a parameter, and a binary sensor where an alarm was raised."""

import json
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from agent import __version__
from agent.northbound.interface.peer import Row


class Discovery:
    """What was announced over one connection.

    Args:
        prefix: of Home Assistant's discovery.
        status: the topic that says whether the agent is there.
        topic_of: returns where rows of a topic are published.
    """

    def __init__(self, prefix: str, status: str, topic_of: Callable[[str, Row], str]) -> None:
        self._prefix, self._status, self._topic_of = prefix, status, topic_of
        self._known: set[tuple[str, str, str]] = set()

    def new(self, topic: str, rows: Sequence[Row]) -> Iterator[tuple[str, bytes]]:
        """Yield topic and payload of what these rows are the first of."""
        if topic not in {"estimates", "alarms"}:
            return
        for row in rows:
            key = (topic, str(row["rig"]), str(row["parameter"]))
            if key not in self._known:
                self._known.add(key)
                yield self._announcement(topic, row)

    def _announcement(self, topic: str, row: Row) -> tuple[str, bytes]:
        rig, parameter = str(row["rig"]), str(row["parameter"])
        component = "sensor" if topic == "estimates" else "binary_sensor"
        node, thing = _plain(f"deltak_{rig}"), _plain(f"{topic}_{parameter}")
        about: dict[str, Any] = {
            "name": parameter if topic == "estimates" else f"alarm {parameter}",
            "unique_id": f"{node}_{thing}", "object_id": f"{node}_{thing}",
            "state_topic": self._topic_of(topic, row), "json_attributes_topic": self._topic_of(topic, row),
            "availability_topic": self._status,
            "device": {
                "identifiers": [node], "name": rig, "manufacturer": "deltak", "sw_version": __version__,
            },
            "origin": {"name": "deltak", "sw_version": __version__},
        }  # fmt: skip
        about |= _VALUE if topic == "estimates" else _PROBLEM
        if topic == "estimates":
            about["unit_of_measurement"] = row["unit"]
        where = f"{self._prefix}/{component}/{node}/{thing}/config"
        return where, json.dumps(about, ensure_ascii=False).encode()


_VALUE = {"value_template": "{{ value_json.value }}", "state_class": "measurement"}
_PROBLEM = {
    "device_class": "problem",
    "value_template": "{{ 'ON' if value_json.to_state in ['UNACK', 'ACKED'] else 'OFF' }}",
}


def _plain(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)
