"""Rows as JSON: each on a topic naming its rig, kind and parameter or source; older rows on their own topics.

<prefix>/<rig>/<estimates or alarms>/<parameter> and <prefix>/<rig>/<events or health>/<source>; what is sent
after newer rows on <prefix>/<rig>/backfill/... (but for alarms, whose order is kept); and
<prefix>/status/<client id>, which is online or offline.
"""

import json
import math
import re
from typing import Any, Final

from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch, Place, Row
from agent.northbound.mqtt.connection import Connection, client_id_of
from agent.northbound.mqtt.discovery import Discovery

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
