"""The consumers of an agent follow its configurations, and a running agent shows them."""

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from agent.config import RigConfig, parse
from agent.northbound.forwarding import Forwarding
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.northbound.supply import Archive, events, numbers
from tests.scenario.live import wait_until
from tests.storage.conftest import memory
from tests.storage.rows import batch, run_info, select
from tests.unit.config.config_texts import MINIMAL

__all__ = ["memory"]


def config(folder: Path, north: str, rig: str = "press-7") -> RigConfig:
    text = MINIMAL.replace('name = "bench"', f'name = "{rig}"') + north
    return parse(text.encode(), folder / f"{rig}.toml")


def table(name: str, **keys: Any) -> str:
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
    return (
        f'\n[[north]]\nname = "{name}"\n'
        f'kind = "mqtt"\nurl = "mqtt://127.0.0.1"\ntopics = ["estimates"]\n{lines}\n'
    )


@contextmanager
def storing(path: Path) -> Iterator[StoreWriter]:
    writer = StoreWriter(lambda: Store.open(path), [run_info()], served=None, period_s=0.02)
    writer.start()
    try:
        yield writer
    finally:
        writer.stop()


def test_consumers_follow_the_configurations(memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archives = {"one": Archive(), "two": Archive()}
    monkeypatch.setattr("agent.northbound.forwarding.make_peer", lambda c, p: archives[c.name].make(c, p))
    path, forwarding = memory / "rig.db", Forwarding()

    def exchange(north: str) -> None:
        forwarding.exchange({path: [config(memory, north)]}, {path: writer})

    with storing(path) as writer:
        exchange(table("one") + table("two"))
        first = {one.consumer.name: one for one in forwarding.forwarders}
        writer.publish([batch(10)])
        wait_until(lambda: all(one.seqs() for one in archives.values()), "the rows", 10)
        exchange(table("one", batch=7) + table("two"))
        second = {one.consumer.name: one for one in forwarding.forwarders}
        assert second["two"] is first["two"]
        assert second["one"] is not first["one"]
        wait_until(lambda: not first["one"].is_alive(), "the one before to end", 10)
        writer.publish([batch(10, first=10)])
        wait_until(lambda: all(len(one.seqs()) == 80 for one in archives.values()), "more rows", 10)
        assert archives["one"].doubles == archives["two"].doubles == 0
        exchange(table("two"))
        gone = "SELECT count(*) FROM consumers WHERE name = 'one'"
        wait_until(lambda: select(path, gone) == [(0,)], "the cursors to be dropped", 10)
        writer.flush()
        wait_until(lambda: forwarding.documents()[0]["lag"]["estimates"] == 0, "all to arrive", 10)
        assert [one["name"] for one in forwarding.documents()] == ["two"]
        forwarding.stop()
        for one in [*first.values(), *second.values()]:
            one.join(5)
    assert [cause for cause, _ in events(path)] == ["consumer removed"]
    assert {*archives["two"].seqs()} == {*numbers(path)}


def test_consumer_of_rigs_that_share_a_file_is_one_and_its_events_are_of_each(memory: Path) -> None:
    path, forwarding = memory / "rig.db", Forwarding()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    north = table("one").replace("127.0.0.1", f"127.0.0.1:{port}")
    configs = [config(memory, north), config(memory, north, "press-8")]
    runs = [run_info(), run_info("press-8")]
    writer = StoreWriter(lambda: Store.open(path), runs, served=None, period_s=0.02)
    writer.start()
    forwarding.exchange({path: configs}, {path: writer})
    (one,) = forwarding.forwarders
    wait_until(lambda: len(events(path)) == 2, "an event of each", 10)
    assert forwarding.documents()[0]["state"] == "failing"
    assert "refused" in forwarding.documents()[0]["error"]
    writer.publish([batch(10)])
    writer.flush()
    wait_until(lambda: forwarding.documents()[0]["retries"] >= 2, "another attempt", 10)
    assert forwarding.documents()[0]["lag"] == {"estimates": 10}
    forwarding.stop()
    one.join(5)
    writer.stop()
    found = select(path, "SELECT rig, source, cause FROM v_events ORDER BY rig")
    assert found == [("press-7", "one", "consumer failed"), ("press-8", "one", "consumer failed")]
