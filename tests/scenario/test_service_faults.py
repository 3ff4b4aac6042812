"""What a service does where one of its own parts fails: it ends, lets go, and counts what was lost."""

import threading
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.errors import StoreError
from agent.runtime.service import Service
from agent.runtime.sources import connect
from agent.storage.write.store import Store
from drivers.port import SampleBlock
from tests.ports import free_port
from tests.scenario.live import example
from tests.scenario.test_service import renamed


def test_agent_whose_writer_fails_ends_and_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An agent that cannot store anything any more must not look like one that watches."""
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "rig.db"
    (tmp_path / "rig.toml").write_text(renamed(text, "press-7", free_port()), encoding="utf-8")
    service = Service([load(tmp_path / "rig.toml")], db, "live")
    (writer,) = service.writers.values()
    monkeypatch.setattr(writer, "_collect", lambda _: 1 / 0)
    with pytest.raises(RuntimeError, match=r"rig\.db.*ZeroDivisionError"):
        service.run(30.0)
    assert not any(connection.is_alive() for connection in service.connections)


def test_agent_that_cannot_open_one_of_its_databases_lets_go_of_the_others(tmp_path: Path) -> None:
    text = example("modbus", tmp_path).read_text()
    configs = []
    for name in ("left", "right"):
        file = tmp_path / f"{name}.toml"
        file.write_text(
            renamed(text, name, free_port()).replace("two-mass-rig.db", f"{name}.db"), encoding="utf-8"
        )
        configs.append(load(file))
    paths = [config.store.path for config in configs]
    paths[1].write_text("not a database")
    with pytest.raises(StoreError, match="not a deltak database"):
        Service(configs, None, "live").run(None)
    Store.open(paths[0]).close()


def test_samples_that_found_the_queue_full_are_in_the_ledger_once_those_after_them_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agent.runtime.sources.QUEUE_SAMPLES", 100)
    (connection,) = connect([load(example("modbus", tmp_path))], threading.Event())
    for number in range(5):
        connection._driver.counts.received += 50
        connection._put(SampleBlock(np.zeros((50, 3)), number))
        assert (connection.counts.received, connection.dropped) == (0, {})
    arrivals, _ = connection.take()
    assert (
        connection.counts.received
        == sum(len(a.block) for a in arrivals) + connection.dropped["queue full"]
        == 250
    )
