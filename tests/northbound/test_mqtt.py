"""MQTT against mosquitto: every row arrives whatever is cut, and nobody hears a secret."""

import json
import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from paho.mqtt.client import Client, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion

from agent.config.reading.secrets import Secret
from agent.config.sections.north import North
from agent.northbound.interface.peer import Place
from agent.northbound.mqtt.connection import client_id_of
from agent.storage.read import queries
from tests.northbound.line import certificates, disturb, line_to, mosquitto
from tests.northbound.supply import events, numbers, supplied
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import START, batch, ledger, step

__all__ = ["memory"]


class Subscriber:
    """Everything that a broker passes on."""

    def __init__(self) -> None:
        self.messages: list[tuple[str, bytes, bool]] = []

    def rows(self, *, backfill: bool | None = None) -> list[dict[str, Any]]:
        found = [json.loads(payload) for topic, payload, _ in self.messages if "/estimates/" in topic]
        return [row for row in found if backfill in {None, row["backfill"]}]

    def tail(self) -> list[dict[str, Any]]:
        """Return the newest rows that are no backfill."""
        return [
            json.loads(payload)
            for topic, payload, _ in self.messages[-5000:]
            if "press-7/estimates/" in topic
        ]

    def last(self, topic: str) -> bytes | None:
        return next((payload for where, payload, _ in reversed(self.messages) if where == topic), None)


@contextmanager
def subscriber(port: int, name: str = "listener") -> Iterator[Subscriber]:
    found, there = Subscriber(), threading.Event()
    client = Client(CallbackAPIVersion.VERSION2, name, protocol=MQTTv5)
    client.on_message = lambda _c, _d, message: found.messages.append(
        (message.topic, message.payload, message.retain)
    )
    client.on_subscribe = lambda *_: there.set()
    client.on_connect = lambda *_: client.subscribe("#", 1)
    client.connect("127.0.0.1", port, 600)
    client.loop_start()
    assert there.wait(10)
    try:
        yield found
    finally:
        client.disconnect()
        client.loop_stop()


def plant(port: int, **keys: Any) -> North:
    return North(name="plant", kind="mqtt", url=f"mqtt://127.0.0.1:{port}", client_id="press-7", **keys)


def test_databases_of_one_file_name_have_clients_of_their_own(tmp_path: Path) -> None:
    consumer = North(name="plant", kind="mqtt", url="mqtt://127.0.0.1")
    places = [Place(tmp_path / folder / "rig.db", tmp_path) for folder in ("a", "b", "b")]
    first, other, again = (client_id_of(consumer, place) for place in places)
    assert first != other == again


def test_rows_arrive_as_json_on_topics_of_their_own_with_discovery_and_last_will(memory: Path) -> None:
    path = memory / "rig.db"
    with mosquitto(memory) as port, line_to(port) as line, subscriber(port) as seen:
        consumer = plant(line.port, discovery="homeassistant")
        with supplied(path, [consumer]) as (writer, forwarders):
            wait_until(lambda: not forwarders[0]._behind_ns, "the agent to be there", 10)
            assert seen.last("deltak/status/press-7") == b"online"
            writer.publish([batch(3), ledger(), step("NORM", "UNACK"), step("UNACK", "RTNUN", START + 5)])
            wait_until(lambda: len(seen.rows()) == 12, "the rows", 10)
            wait_until(lambda: seen.last("deltak/press-7/health/can") is not None, "health", 10)
            with subscriber(port, "late") as late:
                wait_until(
                    lambda: late.last("deltak/press-7/estimates/k1") is not None, "what is retained", 10
                )
            line.down = True
            line.cut()
            wait_until(lambda: seen.last("deltak/status/press-7") == b"offline", "the last will", 10)
    stored = {(row["parameter"], row["t_ns"]): row for row in queries.estimates(path)}
    for row in seen.rows():
        assert {key: row[key] for key in row.keys() - {"seq", "backfill"}} == stored[
            row["parameter"], row["t_ns"]
        ]
    steps = [
        json.loads(payload) for topic, payload, _ in seen.messages if topic == "deltak/press-7/alarms/k1"
    ]
    assert [(one["seq"], one["from_state"], one["to_state"]) for one in steps] == [
        (1, "NORM", "UNACK"), (2, "UNACK", "RTNUN")]  # fmt: skip
    about = json.loads(seen.last("homeassistant/sensor/deltak_press-7/estimates_k1/config") or b"")
    assert about["state_topic"] == "deltak/press-7/estimates/k1"
    assert (about["unit_of_measurement"], about["availability_topic"]) == ("N/m", "deltak/status/press-7")
    assert seen.last("homeassistant/binary_sensor/deltak_press-7/alarms_k1/config") is not None
    assert json.loads(late.last("deltak/press-7/estimates/k1") or b"")["t_ns"] == START + 2 * 50_000_000


def check_arrival(path: Path, seen: Subscriber) -> int:
    """Nothing is missing and the order is kept, but for batches whose answer was lost; return how many came
    twice."""
    expected = numbers(path)
    wait_until(lambda: {row["seq"] for row in seen.rows()} == {*expected}, "every row", 60)
    firsts: list[int] = []
    for backfill in (False, True):
        sent = list(dict.fromkeys(row["seq"] for row in seen.rows(backfill=backfill)))
        assert sent == sorted(sent)
        firsts += sent
    assert {*firsts} == {*expected}
    return len(seen.rows()) - len(expected)


def test_line_cut_and_frozen_loses_no_row_and_keeps_the_order(memory: Path) -> None:
    path = memory / "rig.db"
    with mosquitto(memory) as port, line_to(port) as line, subscriber(port) as seen:
        consumer = plant(line.port, topics=("estimates",), batch=50, timeout_s=0.3)
        with supplied(path, [consumer], late_s=0.2) as (writer, forwarders):
            disturb(line, writer, forwarders[0], 300, 5)
            check_arrival(path, seen)
    causes = [cause for cause, _ in events(path)]
    assert causes == (["consumer failed", "consumer recovered"] * len(causes))[: len(causes)]
    assert causes


def said_of(path: Path) -> list[str]:
    return [message for cause, message in events(path) if cause == "consumer failed"]


def test_certificates_that_expired_are_an_event_and_a_good_one_is_let_in(memory: Path) -> None:
    certificates(memory)
    settings = (f"allow_anonymous true\ncafile {memory}/ca.pem\ncertfile {memory}/server.pem\n"
                f"keyfile {memory}/server.key\nrequire_certificate true")  # fmt: skip
    own = {"ca": memory / "ca.pem", "cert": memory / "client.pem", "key": memory / "client.key"}
    with mosquitto(memory, settings) as port:
        for name, changes in {
            "good": {},
            "old": {"cert": memory / "expired.pem", "key": memory / "expired.key"},
            "stranger": {"ca": None},
        }.items():
            path = memory / f"{name}.db"
            consumer = plant(port, **own).model_copy(update={"url": f"mqtts://127.0.0.1:{port}", **changes})
            with supplied(path, [consumer]) as (writer, forwarders):
                writer.publish([batch(1)])
                over = {"good": lambda: forwarders[0].sent == 4}.get(name, lambda p=path: bool(said_of(p)))
                wait_until(over, f"the end of {name}", 10)
    with mosquitto(memory, settings.replace("server", "expired")) as port:
        consumer = plant(port, **own).model_copy(update={"url": f"mqtts://127.0.0.1:{port}"})
        with supplied(memory / "server.db", [consumer]):
            wait_until(lambda: bool(said_of(memory / "server.db")), "the broker's expired certificate", 10)
    assert said_of(memory / "good.db") == []
    for name in ("old", "stranger", "server"):
        (words,) = said_of(memory / f"{name}.db")
        assert "(certificate: " in words
    assert "certificate has expired" in said_of(memory / "server.db")[0]
    assert "certificate has expired on 2024-01-02 00:00" in said_of(memory / "old.db")[0]


def test_wrong_password_is_one_event_and_no_secret_is_said_anywhere(
    memory: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    path, planted = memory / "rig.db", "PLANTED-5ecret-0f-the-broker"
    monkeypatch.setenv("BROKER", planted)
    (memory / "users").write_text("press-7:$7$101$aaaa$bbbb\n", encoding="utf-8")
    consumer = {"user": "press-7", "password": Secret(env="BROKER")}
    settings = f"allow_anonymous false\npassword_file {memory}/users"
    with (
        mosquitto(memory, settings) as port,
        supplied(path, [plant(port, **consumer)]) as (writer, forwarders),
    ):
        writer.publish([batch(5)])
        wait_until(lambda: len(said_of(path)) == 1, "the event", 10)
        wait_until(lambda: forwarders[0]._failures > 3, "more attempts", 10)
        said = str(forwarders[0].document())
    assert len(said_of(path)) == 1
    assert "(credentials: " in said_of(path)[0]
    assert len(numbers(path)) == 20
    kept = b"".join(file.read_bytes() for file in memory.glob("rig.db*"))
    assert planted.encode() not in kept
    assert planted not in caplog.text + said
