"""One rig's long computation holds up neither the others nor the end, and the ledger is exact whatever was
left."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.config import load
from agent.records import Health, Record
from agent.runtime.containment import IsolatedPipeline
from agent.runtime.pending import STOPPED
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.service import Service
from agent.runtime.sources import Connection
from agent.runtime.tuning import FINISH_S, PART
from drivers.port import SampleBlock
from drivers.reconnect import LinkEvent
from tests.ports import free_port
from tests.scenario.live import example
from tests.scenario.test_service import renamed
from tests.unit.numerics.rigs import noisy

BLOCK, READ, COST_S = 250, 60, 3.0
RIGS = ("left", "middle", "right")


class Clock:
    """The monotonic clock as the service sees it: it moves while a rig computes, and by nothing else."""

    def __init__(self) -> None:
        self.ns = 1_000_000_000

    def __call__(self) -> int:
        return self.ns


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """A clock that every computation of a rig moves by COST_S."""
    clock, compute = Clock(), IsolatedPipeline.compute

    def dear(pipeline: IsolatedPipeline) -> list[Record]:
        clock.ns += round(COST_S * 1e9)
        return compute(pipeline)

    monkeypatch.setattr("agent.runtime.service.monotonic_ns", clock)
    monkeypatch.setattr("agent.runtime.rig_runtime.monotonic_ns", clock)
    monkeypatch.setattr(IsolatedPipeline, "compute", dear)
    monkeypatch.setattr(RigRuntime, "finish", lambda _: None)
    monkeypatch.setattr(Connection, "start", lambda _: None)
    return clock


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    """A service of three rigs that nothing is connected to."""
    text, configs = example("modbus", tmp_path).read_text(), []
    for name in RIGS:
        (tmp_path / f"{name}.toml").write_text(renamed(text, name, free_port()), encoding="utf-8")
        configs.append(load(tmp_path / f"{name}.toml"))
    service = Service(configs, tmp_path / "all.db", "live")
    yield service
    for writer in service.writers.values():
        writer.stop()


def fill(connection: Connection, blocks: int, first: int = 0) -> None:
    """Let a connection have read blocks of the healthy rig's samples, all those from number `first` on."""
    v = noisy(np.random.default_rng(3), first + blocks * BLOCK, 1e-6).v[:, [2, 0, 1]]
    connection._driver.counter_modulus = 2**32
    for start in range(first, first + blocks * BLOCK, BLOCK):
        connection._driver.counts.received += BLOCK
        counter = np.arange(start, start + BLOCK, dtype=np.int64)
        connection._put(SampleBlock(v[start : start + BLOCK], (start + BLOCK) * 1_000_000, counter))


def ledgers(service: Service) -> dict[str, Health]:
    """The newest ledger of each rig."""
    found: list[Any] = []
    for rig in service.rigs.values():
        rig._publish = found.extend
    service.rig_set.ledgers()
    return {record.rig: record for record in found if isinstance(record, Health)}


def balanced(health: Health) -> bool:
    return health.received == health.used + sum(health.rejected.values()) + sum(health.dropped.values())


def test_rig_that_is_behind_lets_the_others_have_their_turn(service: Service) -> None:
    left, _, right = service.connections
    fill(left, 40)
    fill(right, 1)
    service.process()
    found = ledgers(service)
    assert found["right"].used == BLOCK
    assert 0 < found["left"].used <= PART + BLOCK
    assert all(balanced(health) for health in found.values())
    fill(right, 1, first=BLOCK)
    fill(left, 2, first=40 * BLOCK)  # stays in its queue, which is bounded
    service.process()
    found = ledgers(service)
    assert found["right"].used == 2 * BLOCK
    assert PART < found["left"].used <= 2 * (PART + BLOCK)
    while service._behind() or left._waiting:
        service.process()
    assert ledgers(service)["left"].used == 42 * BLOCK


def test_loss_of_a_source_is_told_after_the_samples_before_it(service: Service) -> None:
    left = service.connections[0]
    fill(left, 20)
    left._say(LinkEvent("lost", "planted", 6.0))
    rig = service.rigs["left"]
    service.process()
    assert rig._lost == {}
    while service._behind():
        service.process()
    assert rig._lost == {"modbus": True}
    assert ledgers(service)["left"].used == 20 * BLOCK


@pytest.mark.parametrize("by_signal", [False, True])
def test_end_waits_for_no_more_than_one_computation_beyond_its_time(
    service: Service, clock: Clock, by_signal: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for connection in service.connections:
        fill(connection, READ)
    begun, duration_s = clock.ns, 5.0
    if by_signal:  # while the second rig computes

        def asked(rig: RigRuntime) -> None:
            if clock.ns > begun + duration_s * 1e9:
                service._stop.set()

        monkeypatch.setattr(RigRuntime, "_note_steps", asked)
    service.run(None if by_signal else duration_s)
    assert clock.ns - begun <= (duration_s + COST_S + FINISH_S + COST_S) * 1e9
    found = ledgers(service)
    for health in found.values():
        assert health.received == READ * BLOCK
        assert health.dropped[STOPPED] > 0
        assert balanced(health)
