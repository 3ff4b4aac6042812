"""A fault in one rig's numerics is told and counted, and neither ends the agent nor touches another rig."""

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.config import load
from agent.records import Health, HealthEvent, Record
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.service import Service
from agent.runtime.tuning import PAUSE_NS
from agent.types import AlarmTransition, EstimateBatch, Reason, SensorEvent, SensorFault, Status
from drivers.port import FloatArray, SampleBlock
from tests.ports import free_port
from tests.scenario.live import example, rows
from tests.scenario.test_service import renamed
from tests.unit.numerics.rigs import noisy

SECONDS, FAULT_AT = 5, 1500
PIECE = 50


class Broken:
    """An estimator that raises from a sample on, once or at each call; otherwise as the one it stands for."""

    def __init__(self, real: Any) -> None:
        self._real = real

    def step(self, index: int, y: FloatArray, *more: Any) -> Any:
        """Estimate, until the sample is reached."""
        if index + len(y) > FAULT_AT:
            raise np.linalg.LinAlgError("planted: the SVD did not converge")
        return self._real.step(index, y, *more)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._real, name)


def blocks(seconds: int = SECONDS) -> Iterator[SampleBlock]:
    """The healthy rig's samples as a bus delivers them: 50 at a time, each block received when its last was
    taken."""
    v = noisy(np.random.default_rng([4, 44]), 1000 * seconds, 1e-6).v[:, [2, 0, 1]]
    for start in range(0, len(v), PIECE):
        counter = np.arange(start, start + PIECE, dtype=np.int64)
        yield SampleBlock(v[start : start + PIECE], (start + PIECE) * 1_000_000, counter, wall_offset_ns=0)


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[Service, Path]]:
    """A service of two rigs that nothing is connected to."""
    text, db = example("modbus", tmp_path).read_text(), tmp_path / "both.db"
    configs = []
    for name in ("left", "right"):
        (tmp_path / f"{name}.toml").write_text(renamed(text, name, free_port()), encoding="utf-8")
        configs.append(load(tmp_path / f"{name}.toml"))
    service = Service(configs, db, "live")
    for writer in service.writers.values():
        writer.start()
    yield service, db
    for writer in service.writers.values():
        writer.stop()


def play(service: Service) -> None:
    """Give both rigs the same samples and let the service compute after each block."""
    for block in blocks():
        for connection in service.connections:
            connection._driver.counts.received += len(block)
            connection._driver.counter_modulus = 2**32
            connection._put(block)
        service.process()


def test_fault_in_one_rig_leaves_the_other_rig_its_rows_and_starts_that_rig_anew(
    pair: tuple[Service, Path], caplog: pytest.LogCaptureFixture
) -> None:
    service, db = pair
    estimation = service.rigs["left"].pipeline.stages.estimation
    estimation.estimator = Broken(estimation.estimator)
    with caplog.at_level(logging.WARNING):
        play(service)
        for rig in service.rigs.values():
            rig.finish()
        service.rig_set.ledgers()
    for writer in service.writers.values():
        writer.stop()
    found = {run["rig"]: run for run in (rig.summary.document(1.0) for rig in service.rigs.values())}
    for run in found.values():
        samples = run["samples"]
        assert samples["received"] == 1000 * SECONDS == samples["used"] + sum(samples["rejected"].values())
    assert found["right"]["samples"]["rejected"] == {}
    lost = found["left"]["samples"]["rejected"]["failure"]
    assert 0 < lost <= PAUSE_NS[0] / 1e6 + 4 * PIECE
    # a slow machine computes behind as well, which is another alarm
    failed = [alarm["state"] for alarm in found["left"]["alarms"] if alarm["parameter"] == "estimation"]
    assert failed == ["RTNUN"]
    assert found["left"]["estimates"]["k1"]["status"] == "valid"
    assert found["right"]["estimates"]["k1"]["n_valid"] > found["left"]["estimates"]["k1"]["n_valid"] > 0
    ((message,),) = rows(
        db, "SELECT message FROM v_alarms WHERE kind = 'source' AND parameter = 'estimation'"
    )
    assert "LinAlgError: planted: the SVD did not converge" in message
    # the traceback is in the log, which shows it where it is set to debug
    (record,) = [r for r in caplog.records if r.exc_info]
    assert record.name == "agent.runtime.containment"


def test_fault_that_comes_back_is_tried_less_and_less_often_and_every_sample_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[Record] = []
    rig = RigRuntime(load(example("modbus", tmp_path)), published.extend)

    def broken(*_: Any) -> None:
        raise ValueError("planted")

    monkeypatch.setattr("agent.blocks.estimation.Estimation.step", broken)
    received = 0
    for block in blocks(12):
        received += len(block)
        rig.isolated.take("modbus", block, 2**32, None)
        published += rig.isolated.compute()
    events = [record for record in published if isinstance(record, HealthEvent)]
    assert [record.cause for record in events] == ["failure"] * 4
    alarms = [record for record in published if isinstance(record, AlarmTransition)]
    assert [(record.kind, record.parameter, record.to_state) for record in alarms] == [
        ("source", "estimation", "UNACK")
    ]
    assert not any(isinstance(record, EstimateBatch | Health) for record in published)
    used, rejected = rig.pipeline.ledger.ends("modbus")
    assert used + rejected.total() == received


def test_pause_after_a_fault_that_keeps_coming_back_grows_to_a_minute_and_stays_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = RigRuntime(load(example("modbus", tmp_path)), lambda _: None)

    def broken(*_: Any) -> None:
        raise ValueError("planted")

    monkeypatch.setattr("agent.blocks.estimation.Estimation.step", broken)
    pauses = []
    for second in range(1, 320):
        counter = np.arange(1000 * second, 1000 * second + PIECE, dtype=np.int64)
        block = SampleBlock(np.ones((PIECE, 3)), second * 1_000_000_000, counter, wall_offset_ns=0)
        rig.isolated.take("modbus", block, 2**32, None)
        if any(isinstance(record, HealthEvent) for record in rig.isolated.compute()):
            pauses.append(rig.isolated._pause_ns // 1_000_000_000)
    assert pauses == [1, 2, 4, 8, 16, 32, *[60] * 5]


def test_sensor_alarm_that_stood_before_a_fault_clears_once_estimates_are_valid_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    published: list[Record] = []
    rig = RigRuntime(load(example("modbus", tmp_path)), published.extend)
    channel = rig.config.outputs[0].name
    rig.pipeline.sensor_alarms.step([SensorEvent(SensorFault(channel, Reason.STUCK), True, 0, 0)])
    monkeypatch.setattr(rig.pipeline.stages.quality, "step", lambda *_: 1 / 0)
    for block in blocks(4):
        rig.isolated.take("modbus", block, 2**32, None)
        published += rig.isolated.compute()
    steps = [(r.kind, r.parameter, r.to_state) for r in published if isinstance(r, AlarmTransition)]
    assert ("sensor", channel, "RTNUN") in steps


def test_numerical_failure_inside_the_method_costs_a_windows_rows_no_sample_and_raises_the_alarm(
    tmp_path: Path,
) -> None:
    published: list[Record] = []
    rig = RigRuntime(load(example("modbus", tmp_path)), published.extend)
    contained = rig.pipeline.stages.estimation.estimator
    assert isinstance(contained, ContainedEstimator)
    contained.estimator = Broken(contained.estimator)
    # the one that takes its place fails at the same samples, the next one does not
    after = iter([Broken(contained.make(contained.budget)), contained.make(contained.budget)])
    contained.make = lambda _: next(after)
    for block in blocks(3):
        rig.isolated.take("modbus", block, 2**32, None)
        published += rig.isolated.compute()
    batches = [record for record in published if isinstance(record, EstimateBatch)]
    diverged = np.concatenate([(batch.reason == Reason.DIVERGED).all(axis=1) for batch in batches])
    index = np.concatenate([batch.index for batch in batches])
    assert index[diverged].tolist() == [FAULT_AT + PIECE - 1]
    assert np.all(np.diff(index) == PIECE)
    assert (batches[-1].status == Status.VALID).all()
    alarms = [record for record in published if isinstance(record, AlarmTransition)]
    assert [(alarm.parameter, alarm.to_state) for alarm in alarms] == [
        ("estimation", "UNACK"),
        ("estimation", "RTNUN"),
    ]
    assert "LinAlgError: planted" in alarms[0].message
    assert rig.pipeline.ledger.ends("modbus")[1].total() == 0
