"""The agent on a machine whose wall clock is wrong: from the samples of a bus to the rows that are left."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from agent.config import RigConfig, load
from agent.records import Health, Record, RunInfo
from agent.runtime import rig_runtime
from agent.runtime.rig_runtime import RigRuntime
from agent.runtime.sources import Arrival, Use
from agent.storage.write.retention import Retention
from agent.storage.write.store import Store
from drivers.port import Counts
from tests.scenario.live import example, rows
from tests.scenario.test_isolation import blocks
from tests.storage.rows import START, batch

SECOND = 10**9
YEAR = 365 * 86_400 * SECOND


class Agent:
    """One rig's part of an agent, played some seconds at a time with a wall clock of the test's choice."""

    def __init__(self, config: RigConfig, db: Path) -> None:
        self.config, self.db = config, db
        self.health: list[Health] = []

    def run(self, *offsets_ns: int, seconds: int = 3) -> None:
        """Let it run, so many seconds with each setting of the wall clock."""
        with Store.open(self.db, Retention()) as store:
            run = store.begin_run(self.info(offsets_ns[0]))

            def publish(records: Sequence[Record]) -> None:
                store.write(run, records)
                self.health += [record for record in records if isinstance(record, Health)]

            rig = RigRuntime(self.config, publish, wall=lambda: offsets_ns[-1])
            for number, block in enumerate(blocks(seconds * len(offsets_ns))):
                offset = offsets_ns[number * len(block) // (1000 * seconds)]
                use = Use(self.config.rig.name, self.config.source[0].name, (0, 1, 2))
                rig.take(use, Arrival(replace(block, wall_offset_ns=offset), Counts(), 2**32))
                rig.compute()
            rig.finish()
            store.maintain(finish=True)

    def info(self, started_ns: int) -> RunInfo:
        return RunInfo(self.config.rig.name, "live", started_ns, "0", "0" * 64)

    def seed(self, hops: int, **changes: int) -> None:
        """Store rows as an agent did that ran before."""
        with Store.open(self.db, Retention()) as store:
            run = store.begin_run(self.info(START))
            store.write(run, [batch(hops, rig=self.config.rig.name, **changes)])
            store.maintain(finish=True)

    def shown(self, run_id: int) -> int:
        (found,) = rows(
            self.db, f"SELECT count(DISTINCT t_ns) FROM v_estimates WHERE run_id = {run_id} AND span_s = 0"
        )
        return int(found[0])


@pytest.fixture
def agent(tmp_path: Path) -> Agent:
    return Agent(load(example("modbus", tmp_path)), tmp_path / "rig.db")


def test_three_seconds_a_year_ahead_purge_nothing_and_neither_do_later_starts(agent: Agent) -> None:
    agent.seed(199, hop_ns=SECOND)
    agent.run(START + YEAR)
    assert agent.shown(1) == 199
    agent.run(START + 300 * SECOND)
    agent.run(START + 310 * SECOND)
    assert [agent.shown(run) > 50 for run in (1, 2, 3, 4)] == [True] * 4
    assert agent.shown(1) == 199
    newest = rows(agent.db, "SELECT DISTINCT time FROM v_latest")
    assert [time[:16] for (time,) in newest] == ["2026-01-01T00:05"]


def test_step_in_a_run_is_one_event_and_one_warning_and_the_run_stays_one(
    agent: Agent, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        agent.run(START, START - 2 * 3600 * SECOND)
    steps = rows(agent.db, "SELECT cause, message FROM v_events WHERE source = 'clock'")
    assert [(cause, "stepped by -7200.000 s" in words) for cause, words in steps] == [("clock step", True)]
    assert sum("stepped by -7200.000 s" in record.getMessage() for record in caplog.records) == 1
    assert rows(agent.db, "SELECT count(*) FROM v_runs") == [(1,)]
    newest = rows(agent.db, "SELECT max(t_ns) FROM v_latest")[0][0]
    assert START - 2 * 3600 * SECOND < newest < START - 7190 * SECOND


def test_lag_runs_on_the_monotonic_clock(agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    published: list[Record] = []
    rig = RigRuntime(agent.config, published.extend, wall=lambda: START + YEAR)
    monkeypatch.setattr(rig_runtime, "monotonic_ns", lambda: 2_500_000_000)
    monkeypatch.setattr(rig_runtime, "wall_ns", lambda: START + YEAR, raising=False)
    use = Use(agent.config.rig.name, agent.config.source[0].name, (0, 1, 2))
    for block in blocks(2):
        ahead = 0 if block.arrival_ns < SECOND else YEAR
        rig.take(use, Arrival(replace(block, wall_offset_ns=START + ahead), Counts(), 2**32))
        rig.compute()
    found = rig.pipeline.newest_ns
    assert found == START + YEAR + 2 * SECOND
    monkeypatch.setattr(type(rig.waiting), "counts", lambda *_: (Counts(), Counts().dropped))
    connection = type("Connection", (), {"uses": (use,)})()
    rig.ledger([connection])
    (health,) = [record for record in published if isinstance(record, Health)]
    assert health.lag_s == pytest.approx(0.5)
