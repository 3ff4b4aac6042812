"""An edge node of Sparkplug B: births, data by alias, rebirth when a host asks for it, death by the broker.

Data have quality of service 0, which no broker acknowledges. A subscription made after a batch is: the broker
takes what one connection sends in order, so its answer says that it has the batch.
"""

import json
import re
import socket
from itertools import groupby
from typing import Final

from agent import __version__
from agent.clock import wall_ns
from agent.config.sections.north import North
from agent.northbound.interface.peer import Batch, PeerError, Place, Row
from agent.northbound.mqtt.connection import Connection
from agent.northbound.sparkplug.metrics import Device, Reading, readings
from agent.northbound.sparkplug.payload import BOOLEAN, INT64, STRING, Metric, commands, encode

_SPACE: Final = "spBv1.0"
_REBIRTH: Final = "Node Control/Rebirth"
_BD_SEQ: Final = "bdSeq"
_NUMBERS: Final = 256
"""Fixed by Sparkplug 3.0: seq and bdSeq begin anew after so many."""


class SparkplugPeer:
    """A broker whose hosts understand Sparkplug B.

    Args:
        consumer: its table of the configuration; prefix is the group.
        place: the agent around it.
    """

    def __init__(self, consumer: North, place: Place) -> None:
        self._consumer, self._place = consumer, place
        self._node = consumer.node or node_of(place)
        self._bd_seq = place.number(_BD_SEQ)
        will = (self._topic("NDEATH"), encode([self._bd_metric()]), 1, False)
        self._connection = Connection(consumer, place, will, self._arrived)
        self._devices: dict[str, Device] = {}
        self._aliases = 0
        self._seq = 0
        self._is_born = False
        self._was_born = False
        self._host: tuple[int, bool] | None = None

    def open(self) -> None:
        self._place.keep_number(_BD_SEQ, (self._bd_seq + 1) % _NUMBERS)
        for rig, rows in groupby(sorted(self._place.newest(), key=_rig), _rig):
            for reading in (reading for row in rows for reading in readings("estimates", row)):
                self._learn(rig, reading, historical=False)
        self._connection.open()
        if self._consumer.primary_host is not None:
            self._connection.subscribe(f"{_SPACE}/STATE/{self._consumer.primary_host}", retained=True)
            self._connection.wait(
                lambda: self._host is not None and self._host[1], "the primary host is not online"
            )
        self._connection.subscribe(self._topic("NCMD"))
        self._be_born()
        self._settle()

    def deliver(self, batch: Batch) -> None:
        self.check()
        historical = batch.backfill and batch.topic != "alarms"
        found = [(_rig(row), list(readings(batch.topic, row)), row["t_ns"]) for row in batch.rows]
        for rig, heard, _ in found:
            for reading in heard:
                self._learn(rig, reading, historical=historical)
        for rig, device in self._devices.items():
            if device.is_due:
                self._birth_of(rig)
        for (rig, _), group in groupby(found, lambda one: (one[0], one[2])):
            device = self._devices[rig]
            metrics = [
                device.data(reading, historical=historical) for _, heard, _ in group for reading in heard
            ]
            self._send("DDATA", metrics, rig)
        self._settle()

    def check(self) -> None:
        self._connection.check()
        if self._consumer.primary_host is not None and self._host is not None and not self._host[1]:
            raise PeerError("refused", f"the primary host {self._consumer.primary_host} is offline")
        if not self._is_born:
            self._be_born()

    def close(self) -> None:
        self._connection.close(with_will=self._was_born)

    def _topic(self, kind: str, device: str | None = None) -> str:
        parts = [_SPACE, self._consumer.prefix, kind, self._node]
        return "/".join(parts if device is None else [*parts, device])

    def _learn(self, rig: str, reading: Reading, *, historical: bool) -> None:
        device = self._devices.setdefault(rig, Device())
        if device.learn(reading, self._aliases + 1, historical=historical):
            self._aliases += 1
            device.is_due = True

    def _bd_metric(self) -> Metric:
        return Metric(INT64, self._bd_seq, wall_ns() // 1_000_000, name=_BD_SEQ)

    def _be_born(self) -> None:
        """Send the birth of the node and of every device; what is sent next counts from there."""
        self._is_born = True
        self._was_born = True
        self._seq = 0
        now = wall_ns() // 1_000_000
        self._send("NBIRTH", [
            self._bd_metric(), Metric(BOOLEAN, False, now, name=_REBIRTH),
            Metric(STRING, f"deltak {__version__}", now, name="Properties/Software"),
        ])  # fmt: skip
        for rig in self._devices:
            self._birth_of(rig)

    def _birth_of(self, rig: str) -> None:
        device = self._devices[rig]
        device.is_due = False
        self._send("DBIRTH", device.birth(), rig)

    def _send(self, kind: str, metrics: list[Metric], device: str | None = None) -> None:
        payload = encode(metrics, wall_ns() // 1_000_000, self._seq)
        self._connection.publish(self._topic(kind, device), payload, qos=0)
        self._seq = (self._seq + 1) % _NUMBERS

    def _settle(self) -> None:
        """Wait until the broker has what was sent: it answers in order."""
        self._connection.subscribe(self._topic("NCMD"))

    def _arrived(self, topic: str, payload: bytes) -> None:
        """Take note of a host's command or state; called in the library's thread."""
        if topic == self._topic("NCMD"):
            try:
                wants = commands(payload).get(_REBIRTH, False)
            except ValueError:
                return
            self._is_born = self._is_born and not wants
        elif topic == f"{_SPACE}/STATE/{self._consumer.primary_host}":
            self._host = _newer(self._host, payload)


def node_of(place: Place) -> str:
    """Return the identifier of a node for which none is configured: of host and database."""
    return re.sub(r"[+#/]", "_", f"{socket.gethostname()}-{place.db.stem}")


def _newer(known: tuple[int, bool] | None, payload: bytes) -> tuple[int, bool] | None:
    """Return when a host was in which state (ms, online); what is older than known, or none, says nothing."""
    try:
        said = json.loads(payload)
        found = int(said["timestamp"]), said["online"] is True
    except (ValueError, KeyError, TypeError):
        return known
    return known if known is not None and found[0] < known[0] else found


def _rig(row: Row) -> str:
    return str(row["rig"])
