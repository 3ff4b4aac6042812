"""A broker and a database server themselves killed and frozen, not their line alone: no row is missing."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from paho.mqtt.client import Client, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from agent.northbound.forwarder import Forwarder
from agent.storage.write.writer import StoreWriter
from tests.figures import figure
from tests.northbound.line import Server, broker, database
from tests.northbound.supply import events, numbers, supplied
from tests.northbound.test_mqtt import Subscriber, check_arrival
from tests.northbound.test_mqtt import plant as at_broker
from tests.northbound.test_postgres import PLANTED, asked
from tests.northbound.test_postgres import plant as at_database
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import batch

__all__ = ["memory"]
pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]
INSTANTS = 40
"""Stored before, while and after a server is away."""
LIVE = 10
"""Of those that are stored once it is back, one at a time, to see how soon each arrives."""
LATE_S, BEHIND_S, OUTAGE_S = 2.0, 1.0, 1.5
"""After which a new row must have come; after which rows are backfill (5 s unless told); of an outage."""
KEEPING = """allow_anonymous true
persistence true
persistence_location {folder}/
autosave_on_changes true
autosave_interval 1
max_inflight_messages 0"""
"""What a broker needs that is to remember, over a kill, who listens: written down at each change."""


@contextmanager
def listener(port: int) -> Iterator[tuple[Subscriber, Callable[[], bool]]]:
    """Listen to a broker, over its ends, in a session that it keeps; yields also whether it is connected."""
    found = Subscriber()
    client = Client(CallbackAPIVersion.VERSION2, "listener", protocol=MQTTv5)
    client.on_message = lambda _c, _d, message: found.messages.append(
        (message.topic, message.payload, message.retain)
    )
    client.on_connect = lambda *_: client.subscribe("#", 1)
    kept = Properties(PacketTypes.CONNECT)
    kept.SessionExpiryInterval = 3600
    client.connect("127.0.0.1", port, 600, clean_start=False, properties=kept)
    client.loop_start()
    try:
        wait_until(client.is_connected, "the listener", 10)
        yield found, client.is_connected
    finally:
        client.disconnect()
        client.loop_stop()


class Round:
    """Rows stored before, while and after a server is away."""

    def __init__(self, path: Path, server: Server, writer: StoreWriter, forwarder: Forwarder) -> None:
        self._path, self._server, self._writer, self._forwarder = path, server, writer, forwarder
        self._stored = 0

    def _store(self, instants: int) -> int:
        """Store instants; return the number of the last row."""
        self._writer.publish([batch(instants, first=self._stored)])
        self._writer.flush()
        self._stored += instants
        return numbers(self._path)[-1]

    def away(self, *, frozen: bool) -> None:
        """Take the server away amid what is sent, store meanwhile, and bring it back."""
        sent, failed = self._forwarder.sent, self._forwarder.retries
        self._writer.publish([batch(INSTANTS, first=self._stored)])
        self._stored += INSTANTS
        wait_until(lambda: self._forwarder.sent > sent, "the first rows to go", 20)
        if frozen:
            self._server.send(signal.SIGSTOP)
        else:
            self._server.kill()
        self._store(INSTANTS)
        wait_until(lambda: self._forwarder.retries > failed, "an attempt in vain", 20)
        until = time.monotonic() + OUTAGE_S
        wait_until(lambda: self._forwarder.retries > failed + 1 and time.monotonic() > until, "another", 20)
        if frozen:
            self._server.send(signal.SIGCONT)
        else:
            self._server.start()
        wait_until(lambda: self._forwarder.document()["state"] == "ok", "its return to be noticed", 40)

    def live(self, arrived: Callable[[int], bool]) -> list[float]:
        """Store instants one after the other; return how long each took to arrive, s."""
        took = []
        for _ in range(LIVE):
            begun, newest = time.monotonic(), self._store(1)
            wait_until(lambda n=newest: arrived(n), "a new row", 20)
            took.append(time.monotonic() - begun)
        return took


FATES = [False, True, False, True, False, False]
"""Whether the server freezes, else it is killed."""
TIMES = f"killed {FATES.count(False)} times and frozen {FATES.count(True)}"


def test_broker_that_is_killed_and_frozen_lacks_no_row_and_new_ones_come_within_two_seconds(
    memory: Path,
) -> None:
    path, took = memory / "rig.db", []
    with broker(memory, KEEPING.format(folder=memory)) as server, listener(server.port) as (seen, is_heard):
        consumer = at_broker(server.port, topics=("estimates",), batch=20, timeout_s=0.5)
        with supplied(path, [consumer], late_s=BEHIND_S) as (writer, forwarders):
            one = Round(path, server, writer, forwarders[0])
            for frozen in FATES:
                one.away(frozen=frozen)
                wait_until(is_heard, "the listener's own return", 20)
                took += one.live(lambda n: any(row["seq"] == n for row in seen.rows(backfill=False)))
            twice = check_arrival(path, seen)
    rows, late = len(numbers(path)), {row["seq"] for row in seen.rows(backfill=True)}
    causes = [cause for cause, _ in events(path)]
    assert causes == ["consumer failed", "consumer recovered"] * len(FATES)
    assert len(late) >= len(FATES) * INSTANTS
    assert max(took) <= LATE_S
    figure(f"mosquitto {TIMES}: of {rows} rows 0 lost, "
           f"{twice} twice, {len(late)} as backfill; a new row after {max(took):.2f} s at most")  # fmt: skip


def test_database_server_that_is_killed_and_frozen_has_each_row_once(memory: Path) -> None:
    path, took = memory / "rig.db", []
    with database(memory, PLANTED) as server:
        consumer = at_database(server.port, "killed", memory, topics=("estimates",), batch=20, timeout_s=1.0)
        found = "SELECT 1 FROM killed_estimates WHERE seq = %s AND NOT backfill"

        with supplied(path, [consumer], late_s=BEHIND_S) as (writer, forwarders):
            one = Round(path, server, writer, forwarders[0])
            for frozen in FATES:
                one.away(frozen=frozen)
                took += one.live(lambda n: bool(asked(server.port, found, n)))
            wait_until(lambda: not any(forwarders[0].document()["backfill"].values()), "what was lacking", 60)
        stored = [seq for (seq,) in asked(server.port, "SELECT seq FROM killed_estimates ORDER BY seq")]
        late = asked(server.port, "SELECT count(*) FROM killed_estimates WHERE backfill")[0][0]
    assert stored == numbers(path)
    assert late >= len(FATES) * INSTANTS
    assert max(took) <= LATE_S
    figure(f"PostgreSQL {TIMES}: of {len(stored)} rows 0 "
           f"lost, 0 twice, {late} as backfill; a new row after {max(took):.2f} s at most")  # fmt: skip
