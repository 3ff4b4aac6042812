"""Sparkplug B against mosquitto: each message is decoded by the Eclipse project's own package and as
specified.

The names of the assertions of Sparkplug 3.0.0 stand beside what holds them.
"""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.client import Client, MQTTv5
from paho.mqtt.enums import CallbackAPIVersion

from agent.config.sections.north import North
from agent.northbound.sparkplug.payload import (
    BOOLEAN,
    DOUBLE,
    INT64,
    STRING,
    Metric,
    commands,
    encode,
    fields,
    varint,
)
from agent.storage.write.store import Store
from tests.northbound.line import line_to, mosquitto
from tests.northbound.supply import numbers, supplied
from tests.northbound.test_mqtt import said_of, subscriber
from tests.peers import ROOT, missing, program
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import batch, ledger, run_info, step

__all__ = ["memory"]
Decoded = list[tuple[str, dict[str, Any]]]


def decoded(messages: list[tuple[str, bytes, bool]]) -> Decoded:
    """Return the Sparkplug messages by the independent decoder."""
    node = program("node", "nodejs")
    modules = ROOT / ".venv" / "node" / "node_modules"
    if not (modules / "sparkplug-payload").is_dir():
        missing("the package sparkplug-payload of npm is not installed (tests/install_peers.sh)")
    wanted = [
        (topic, payload) for topic, payload, _ in messages if "/STATE/" not in topic and "/NCMD/" not in topic
    ]
    lines = "".join(f"{payload.hex()}\n" for _, payload in wanted)
    made = subprocess.run([node, "tests/northbound/decode.js"], input=lines, capture_output=True, text=True,
                          check=True, cwd=ROOT, env={**os.environ, "NODE_PATH": str(modules)})  # fmt: skip
    found = [json.loads(line) for line in made.stdout.split("\n") if line]
    return [(topic, one) for (topic, _), one in zip(wanted, found, strict=True)]


def plant(port: int, **keys: Any) -> North:
    url = f"mqtt://127.0.0.1:{port}"
    return North(name="scada", kind="sparkplug", url=url, client_id="edge", node="gw", prefix="hall", **keys)


@contextmanager
def host(port: int) -> Iterator[Client]:
    client = Client(CallbackAPIVersion.VERSION2, "host", protocol=MQTTv5)
    client.connect("127.0.0.1", port, 60)
    client.loop_start()
    try:
        yield client
    finally:
        client.disconnect()
        client.loop_stop()


def kinds(messages: list[tuple[str, bytes, bool]]) -> list[str]:
    return [topic.split("/")[2] for topic, _, _ in messages]


def check_edge_node(messages: Decoded) -> list[tuple[str, int, bool]]:
    """Hold what one edge node sent to the specification; return values by metric, and whether they are
    historical."""
    names: dict[int, str] = {}
    types: dict[int, str] = {}
    born: set[str] = set()
    found: list[tuple[str, int, bool]] = []
    bd_seq = next_seq = None
    for topic, payload in messages:
        space, group, kind, node, *device = topic.split("/")
        assert (space, group, node) == ("spBv1.0", "hall", "gw")  # tck-id-topics-*-topic
        metrics = {one["name"]: one for one in payload["metrics"] if one.get("name")}
        if kind == "NDEATH":
            assert "seq" not in payload or not payload["seq"]  # tck-id-payloads-ndeath-seq
            assert metrics["bdSeq"]["value"] == bd_seq  # tck-id-payloads-ndeath-bdseq
            born.clear()
            continue
        assert payload["timestamp"] > 1.7e12  # tck-id-payloads-*-timestamp
        assert all(one["timestamp"] for one in payload["metrics"])  # tck-id-payloads-name-*-timestamp
        if kind == "NBIRTH":
            assert payload["seq"] == 0  # tck-id-payloads-nbirth-seq
            assert metrics["Node Control/Rebirth"]["value"] is False  # tck-id-payloads-nbirth-rebirth-req
            assert not metrics["Node Control/Rebirth"].get("alias")  # tck-id-...-rebirth-name-aliases
            bd_seq = metrics["bdSeq"]["value"]  # tck-id-payloads-nbirth-bdseq
            next_seq, names, born = 1, {}, set()
            continue
        assert payload["seq"] == next_seq  # tck-id-payloads-*-seq-inc
        next_seq = (payload["seq"] + 1) % 256
        if kind == "DBIRTH":
            assert len(metrics) == len(payload["metrics"])  # tck-id-payloads-name-birth-data-requirement
            for name, one in metrics.items():
                assert names.setdefault(one["alias"], name) == name  # tck-id-payloads-alias-uniqueness
                types[one["alias"]] = one["type"]
            born.add(device[0])
        if kind == "DDATA":
            assert device[0] in born  # tck-id-payloads-dbirth-order
            for one in payload["metrics"]:
                assert not one.get("name")  # tck-id-payloads-alias-data-cmd-requirement
                assert one["type"] == types[one["alias"]]
                found.append((names[one["alias"]], one["value"], bool(one.get("isHistorical"))))
    return found


def test_births_data_and_death_are_as_specified_and_every_row_arrives(memory: Path) -> None:
    path = memory / "rig.db"
    with Store.open(path) as store:
        store.write(store.begin_run(run_info()), [batch(30)])
    with mosquitto(memory) as port, line_to(port) as line, subscriber(port) as seen:
        with supplied(path, [plant(line.port, batch=10)]) as (writer, forwarders):
            wait_until(lambda: forwarders[0].sent == 120, "what was missed", 10)
            writer.publish([batch(30, first=200), ledger(), step("NORM", "UNACK")])
            wait_until(lambda: forwarders[0].sent == 242, "what is new", 10)
            line.cut()
            wait_until(lambda: kinds(seen.messages).count("NBIRTH") == 2, "a second birth", 10)
            writer.publish([batch(30, first=400)])
            wait_until(lambda: forwarders[0].sent >= 362, "more", 10)
        wait_until(lambda: kinds(seen.messages)[-1] == "NDEATH", "the death", 10)
        messages = list(seen.messages)
    assert not any(retain for _, _, retain in messages)  # tck-id-payloads-*-retain
    found = check_edge_node(decoded(messages))
    sent = [
        (seq, late) for name, seq, late in found if name in {f"{p}/seq" for p in ("k1", "k2", "B1", "B2")}
    ]
    assert {seq for seq, _ in sent} == {*numbers(path)}
    for wanted in (False, True):
        seqs = list(dict.fromkeys(seq for seq, late in sent if late is wanted))
        assert seqs == sorted(seqs)
    assert {seq for seq, late in sent if late} == {*numbers(path)[:120]}
    assert ("Alarms/k1/state", "UNACK", False) in found
    assert ("Health/can/received", 1000, False) in found
    deaths = [topic for topic, _ in decoded(messages) if "/NDEATH/" in topic]
    assert len(deaths) == 2


def test_host_that_asks_for_it_gets_a_rebirth_and_a_node_waits_for_its_primary_host(memory: Path) -> None:
    path = memory / "rig.db"
    rebirth = encode([Metric(BOOLEAN, True, 1, name="Node Control/Rebirth")], 1)
    with mosquitto(memory) as port, subscriber(port) as seen, host(port) as scada:
        consumer = plant(port, primary_host="scada", timeout_s=1.0, topics=("estimates",))
        with supplied(path, [consumer]) as (writer, forwarders):
            writer.publish([batch(5)])
            wait_until(lambda: bool(said_of(path)), "the host's absence to be said", 10)
            assert "NBIRTH" not in kinds(seen.messages)
            scada.publish(
                "spBv1.0/STATE/scada", json.dumps({"online": True, "timestamp": 10}), 1, retain=True
            )
            wait_until(lambda: forwarders[0].sent == 20, "the rows", 10)
            scada.publish("spBv1.0/NCMD/hall/gw", b"\xff\xff nonsense", 1)
            scada.publish("spBv1.0/hall/NCMD/gw", b"\xff\xff nonsense", 1)
            scada.publish("spBv1.0/hall/NCMD/gw", rebirth, 1)
            wait_until(lambda: "NCMD" in kinds(seen.messages), "the command", 10)
            writer.publish([batch(5, first=5)])
            wait_until(lambda: kinds(seen.messages).count("NBIRTH") == 2, "the rebirth", 10)
            scada.publish(
                "spBv1.0/STATE/scada", json.dumps({"online": False, "timestamp": 5}), 1, retain=True
            )
            writer.publish([batch(5, first=10)])
            wait_until(lambda: forwarders[0].sent == 60, "rows, since that state is an old one", 10)
            scada.publish(
                "spBv1.0/STATE/scada", json.dumps({"online": False, "timestamp": 20}), 1, retain=True
            )
            wait_until(lambda: "NDEATH" in kinds(seen.messages), "the death", 10)
        messages = [one for one in seen.messages if one[0].startswith("spBv1.0/hall/")]
    found = check_edge_node(decoded(messages))
    assert {seq for name, seq, _ in found if name.endswith("/seq")} == {*numbers(path)}
    assert "the primary host scada is offline" in said_of(path)[-1]


VALUES = st.one_of(
    st.tuples(st.just(INT64), st.integers(0, 2**53 - 1)),
    st.tuples(st.just(DOUBLE), st.floats(allow_nan=False)),
    st.tuples(st.just(STRING), st.text(max_size=300)), st.tuples(st.just(BOOLEAN), st.booleans()),
)  # fmt: skip


def test_payloads_of_any_values_are_decoded_as_they_were() -> None:
    made: list[Metric] = []

    @given(VALUES, st.integers(1, 2**40), st.booleans(), st.text(min_size=1, max_size=200))
    def collect(value: tuple[int, Any], t_ms: int, historical: bool, name: str) -> None:
        made.append(Metric(*value, t_ms, name=name, alias=len(made) + 1, historical=historical, unit="N/m"))

    collect()
    payloads = [("t/t/t", encode([one], one.t_ms, number % 256), False) for number, one in enumerate(made)]
    for number, (one, (_, payload)) in enumerate(zip(made, decoded(payloads), strict=True)):
        (metric,) = payload["metrics"]
        value = metric["value"]
        if one.datatype == DOUBLE:  # JSON has no infinity, and writes 1e16 as a whole number
            value = float("inf" if value is None else value)
            assert value == abs(one.value) if value == float("inf") else value == one.value
        assert (metric["name"], metric["alias"]) == (one.name, one.alias)
        assert one.datatype == DOUBLE or value == one.value
        assert (payload["timestamp"], payload["seq"], metric["timestamp"]) == (
            one.t_ms,
            number % 256,
            one.t_ms,
        )
        assert metric["properties"]["engUnit"]["value"] == "N/m"


@given(st.integers(0, 2**64 - 1), st.binary(max_size=60))
def test_what_a_host_sends_is_read_or_refused(number: int, noise: bytes) -> None:
    assert list(fields(varint(24) + varint(number))) == [(3, number)]
    try:
        commands(noise)
    except ValueError:
        return


@pytest.mark.parametrize("wants", [True, False])
def test_command_of_a_host_is_read(wants: bool) -> None:
    payload = encode([Metric(BOOLEAN, wants, 1, name="Node Control/Rebirth")], 1, 3)
    assert commands(payload) == {"Node Control/Rebirth": wants}
