"""A spring that follows the hall, over Modbus beside its thermometer: learnt, then compensated, or not."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agent.blocks.graph import graph_of
from agent.commissioning.baseline.learn import Stretch, learn
from agent.config import load
from agent.evaluation.score import play as playing
from agent.evaluation.score.play import open_bench, play
from agent.records import Baseline, Record
from agent.runtime.rig_runtime import RigRuntime
from agent.storage.read.baselines import standing
from agent.storage.write.store import Store
from agent.types import AlarmTransition, EstimateBatch, Status
from tests.scenario.test_covariates_on_a_bus import REGISTER, written
from tests.storage.rows import run_info

RIG = "two-mass-rig"
PER_KELVIN, SWING_K, PERIOD_S = -0.003, 15.0, 2400.0
LEARNT_S, SEEN_S, LOST_AT_S = 2400, 1650, 1500.0
SLOW = {
    "sample_rate_hz = 1000.0": "sample_rate_hz = 25.0",
    "window_s = 0.25 ": "window_s = 8.0 ",
    "hop_s = 0.05 ": "hop_s = 4.0 ",
    'mode = "ring"': 'mode = "ring"\nperiod_s = 4.0',
}
BEFORE, AFTER = "limit = 15.0 ", "limit_percent = 3.0 "
BASELINE = "[baseline]\nclasses = 3\n"
SCENARIO = """
seed = {seed}
rig = "rig.toml"
duration_s = {seconds}
[[force]]
kind = "random"
rms = 0.7
[[covariate]]
channel = "hall"
kind = "sine"
value = 20.0
amplitude = 15.0
period_s = 2400.0
noise_sd = 0.05
[[wear]]
kind = "covariate"
channel = "hall"
percent = {{ k1 = -0.3 }}
every_s = 5.0
{change}
"""
LOST = f"[[change]]\nat_s = {LOST_AT_S}\npercent = {{ k1 = -6.0 }}\n"


def played(folder: Path, seed: int, seconds: int, change: str = "") -> list[Record]:
    path = folder / "hall.toml"
    path.write_text(SCENARIO.format(seed=seed, seconds=seconds, change=change), encoding="utf-8")
    return play(open_bench(str(path), ()), lambda _: None).records


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Baseline]:
    """A folder with the rig's files, and what an hour of it taught of k1."""
    folder = tmp_path_factory.mktemp("hall")
    path = written(folder, "modbus", REGISTER + BASELINE, **SLOW)
    records = played(folder, 1, LEARNT_S)
    db = folder / "two-mass-rig.db"
    with Store.open(db) as store:
        store.write(store.begin_run(replace(run_info(RIG), graph=graph_of(load(path)))), records)
    learn(path, None, Stretch(("k1",), hours=0.5))
    (k1,) = standing(db, RIG)
    text = path.read_text(encoding="utf-8")
    assert BEFORE in text
    path.write_text(text.replace(BEFORE, AFTER), encoding="utf-8")
    return folder, k1


def begin_with(monkeypatch: pytest.MonkeyPatch, baseline: Baseline) -> None:
    """Have rigs that are played count from a baseline, as the agent's do from what its database has."""

    class Begun(RigRuntime):
        def __init__(self, *arguments: object) -> None:
            super().__init__(*arguments)  # type: ignore[arg-type]
            self.count_from((baseline,))

    monkeypatch.setattr(playing, "RigRuntime", Begun)


def raised(records: Sequence[Record]) -> list[float]:
    """Return when level alarms of k1 are raised, s."""
    steps = (record for record in records if isinstance(record, AlarmTransition))
    return [
        step.t_ns / 1e9
        for step in steps
        if (step.kind, step.parameter, step.to_state) == ("level", "k1", "UNACK")
    ]


def rows_of_k1(records: Sequence[Record]) -> Iterator[tuple[float, float, float, int | None]]:
    """Yield time, s, reference, change and baseline_id of valid rows."""
    for batch in (record for record in records if isinstance(record, EstimateBatch)):
        column = batch.parameters.index("k1")
        reference = float(batch.reference[column])
        baseline = None if batch.baseline_id is None else batch.baseline_id[column]
        for i in np.flatnonzero(batch.status[:, column] == Status.VALID):
            change = float(batch.value[i, column]) - reference
            yield float(batch.t_ns[i]) / 1e9, reference, change, baseline


def test_hall_read_over_modbus_is_learnt_and_taken_out_and_a_loss_beside_it_is_found(
    known: tuple[Path, Baseline], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, baseline = known
    (dependence,) = json.loads(baseline.covariates)
    assert dependence["lower"] < 25.0 * PER_KELVIN < dependence["upper"]
    begin_with(monkeypatch, baseline)
    records = played(folder, 2, SEEN_S, LOST)
    rows = np.array([row for row in rows_of_k1(records) if 300.0 < row[0] < LOST_AT_S])
    felt = 25.0 * (1.0 + PER_KELVIN * SWING_K * np.sin(2 * np.pi * rows[:, 0] / PERIOD_S))
    # minutes count when they have been over for one: the reference is two behind
    assert np.ptp(rows[:, 1]) > 0.7 * np.ptp(felt)
    assert np.corrcoef(rows[:, 1], felt)[0, 1] > 0.95
    assert np.abs(rows[:, 2]).max() < 0.03 * 25.0
    assert set(rows[:, 3]) == {baseline.baseline_id}
    (alarm,) = raised(records)
    assert LOST_AT_S < alarm < LOST_AT_S + 120.0


def test_hall_that_is_not_taken_out_raises_alarms(
    known: tuple[Path, Baseline], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, baseline = known
    begin_with(monkeypatch, replace(baseline, covariates="[]"))
    records = played(folder, 2, 600)
    assert {reference for _, reference, _, _ in rows_of_k1(records)} == {baseline.reference}
    assert raised(records)
