"""Rows as JSON: each on a topic naming its rig, kind and parameter or source; older rows on their own topics.

<prefix>/<rig>/<estimates or alarms>/<parameter> and <prefix>/<rig>/<events or health>/<source>; what is sent
after newer rows on <prefix>/<rig>/backfill/... (but for alarms, whose order is kept); and
<prefix>/status/<client id>, which is online or offline.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from agent import __version__
from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch, Place, Row
from agent.northbound.mqtt.connection import Connection, client_id_of


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


ONLINE: Final = b"online"
OFFLINE: Final = b"offline"
_LAST: Final = {"estimates": "parameter", "alarms": "parameter", "events": "source", "health": "source"}
"""The column that a topic ends with."""
_RETAINED: Final = ("estimates", "alarms", "health")
"""Topics whose newest row is what whoever subscribes gets at once."""


class JsonPeer:
    """A broker that gets rows as JSON.

    Args:
        consumer: its table of the configuration.
        place: the agent around it.
    """

    def __init__(self, consumer: North, place: Place) -> None:
        self._prefix = consumer.prefix
        self._status = f"{consumer.prefix}/status/{client_id_of(consumer, place)}"
        self._connection = Connection(consumer, place, (self._status, OFFLINE, 1, True))
        self._discovery = None
        if consumer.discovery is not None:
            self._discovery = Discovery(consumer.discovery, self._status, self.topic_of)
        self._place = place

    def open(self) -> None:
        self._connection.open()
        waiting = {self._connection.publish(self._status, ONLINE, retain=True)}
        if self._discovery is not None:
            waiting |= self._announced("estimates", self._place.newest())
        self._connection.acknowledged(waiting)

    def deliver(self, batch: Batch) -> None:
        is_aside = batch.backfill and batch.topic != "alarms"
        waiting = set() if is_aside else self._announced(batch.topic, batch.rows)
        retain = batch.topic in _RETAINED and not is_aside
        for row in batch.rows:
            topic = self.topic_of(batch.topic, row, aside=is_aside)
            waiting.add(
                self._connection.publish(topic, payload_of(row, backfill=batch.backfill), retain=retain)
            )
        self._connection.acknowledged(waiting)

    def check(self) -> None:
        self._connection.check()

    def close(self) -> None:
        self._connection.close()

    def topic_of(self, topic: str, row: Row, *, aside: bool = False) -> str:
        """Return where a row is published; aside: where no newer one is held up by it."""
        levels = [str(row["rig"]), *(["backfill"] if aside else []), topic, str(row[_LAST[topic]])]
        return "/".join([self._prefix, *(_level(level) for level in levels)])

    def _announced(self, topic: str, rows: Any) -> set[int]:
        if self._discovery is None:
            return set()
        found = self._discovery.new(topic, rows)
        return {self._connection.publish(where, payload, retain=True) for where, payload in found}


def payload_of(row: Row, *, backfill: bool) -> bytes:
    """Return a row as JSON: its columns, seq, and whether newer rows may have gone before it."""
    cells = {key: None if isinstance(v, float) and not math.isfinite(v) else v for key, v in row.items()}
    return json.dumps({**cells, "backfill": backfill}, ensure_ascii=False, separators=(",", ":")).encode()


def _level(name: str) -> str:
    return re.sub(r"[+#/\x00]", "_", name) or "_"
