"""What was learnt of a rig's disturbances outlives the process: the next start begins with it, another rig does not."""

import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.config import load
from agent.numerics.estimator.calibrate import Calibrator
from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.window.commission import WINDOWS
from agent.runtime.replay import replay
from agent.runtime.service import RigRuntime
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from agent.types import Calibrated, CalibrationRecord, Record, RunInfo
from tests.peers import ROOT
from tests.replay.records import rows_of
from tests.scenario.test_bad_input import configuration
from tests.statistical.coverage import pushed
from tests.statistical.machine import NAMES
from tests.statistical.operation import NOISE_M
from tests.statistical.sensor_faults import healthy

KNOWN = Calibrated((2e-6, 3e-6), (0.0, 0.5), (1.0, 1.25, 0.75, 1.0 / 3.0), searched=True)


def recording(path: Path, columns: np.ndarray[Any, Any]) -> Path:
    force, x1, x2 = columns.T
    np.savez(path, t=1e-3 * np.arange(len(force)), force=force, x1=x1, x2=x2)
    return path


def quiet(folder: Path) -> Path:
    """So many short windows that the commissioning factor is known."""
    samples = 250 * (WINDOWS + 10)
    return recording(folder / "quiet.npz", healthy(np.random.default_rng(4), samples))


def disturbed(folder: Path) -> Path:
    """A force on m1 that nobody measures."""
    found = pushed(np.random.default_rng(5), 6000, (0.5, 0.0))
    return recording(folder / "disturbed.npz", np.column_stack([found.force, found.y]))


def learning(folder: Path, window_s: float = 1.0) -> Path:
    """A configuration that does not say how noisy the sensors are."""
    return configuration(folder, window_s, **{f"noise_sd = {NOISE_M!r}": ""})


def stored(db: Path) -> list[tuple[int, dict[str, Any]]]:
    """(run, content) of every calibration in a file."""
    with sqlite3.connect(db) as base:
        return [(run, json.loads(text)) for run, text in base.execute("SELECT run_id, content FROM calibrations")]


@pytest.fixture
def calibrations(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list that grows with every calibration."""
    made: list[int] = []
    calibrate = Calibrator.calibrate

    def noted(*arguments: Any) -> Any:
        made.append(1)
        return calibrate(*arguments)

    monkeypatch.setattr(Calibrator, "calibrate", noted)
    return made


def test_replay_finds_unknown_forces_once_and_begins_with_them_the_next_time(
    tmp_path: Path, calibrations: list[int]
) -> None:
    config, record, db = learning(tmp_path), disturbed(tmp_path), tmp_path / "rig.db"
    first = replay(config=config, recordings=[record], db=db)
    ((run, content),) = stored(db)
    assert run == first["run_id"]
    assert content["process"][0] == pytest.approx(0.5, rel=0.35)
    assert calibrations
    calibrations.clear()
    second = replay(config=config, recordings=[record], db=db)
    assert not calibrations
    assert len(stored(db)) == 1  # nothing new was learnt
    for name, row in first["estimates"].items():
        again = second["estimates"][name]
        assert (again["status"], again["n_valid"]) == (row["status"], row["n_valid"])
        assert again["value"] == pytest.approx(row["value"], abs=0.05 * row["sd"])
        assert again["sd"] == pytest.approx(row["sd"], rel=0.02)


def test_commissioning_factor_is_there_from_the_first_window_after_a_restart(tmp_path: Path) -> None:
    config, record, db = learning(tmp_path, 0.25), quiet(tmp_path), tmp_path / "rig.db"
    replay(config=config, recordings=[record], db=db)
    ((_, content),) = stored(db)
    assert content["factor"] is not None
    assert any(share != 1.0 for share in content["factor"])
    fresh, known = (rows_of_new_run(config, record, base) for base in (tmp_path / "fresh.db", db))
    for number, name in enumerate(NAMES):
        assert known[name] == pytest.approx(content["factor"][number] * fresh[name], rel=0.01)


def rows_of_new_run(config: Path, record: Path, db: Path) -> dict[str, float]:
    """The sd of each parameter in the first row of a new run that has an estimate."""
    run = replay(config=config, recordings=[record], db=db)["run_id"]
    found = [row for row in rows_of(db) if row["run_id"] == run and row["value"] is not None]
    return {row["parameter"]: row["sd"] for row in reversed(found[:4])}


def test_changed_configuration_is_calibrated_anew(tmp_path: Path, calibrations: list[int]) -> None:
    config, record, db = learning(tmp_path), disturbed(tmp_path), tmp_path / "rig.db"
    replay(config=config, recordings=[record], db=db)
    calibrations.clear()
    config.write_text(config.read_text(encoding="utf-8") + "# mended\n", encoding="utf-8")
    replay(config=config, recordings=[record], db=db)
    assert calibrations
    assert len(stored(db)) == 2


def test_calibration_that_does_not_explain_the_rig_is_made_anew(tmp_path: Path) -> None:
    """A sensor was replaced by a worse one: what was known of its noise must not stop everything."""
    config, db = learning(tmp_path), tmp_path / "rig.db"
    v = healthy(np.random.default_rng(6), 5000, 1e-6)
    replay(config=config, recordings=[recording(tmp_path / "fine.npz", v)], db=db)
    v[:, 1:] += 5e-5 * np.random.default_rng(7).standard_normal((len(v), 2))
    document = replay(config=config, recordings=[recording(tmp_path / "rough.npz", v)], db=db)
    assert {row["status"] for row in document["estimates"].values()} == {"valid"}
    before, now = (content["sigma"][0] for _, content in stored(db))
    assert before == pytest.approx(1e-6, rel=0.2)
    assert now == pytest.approx(5e-5, rel=0.2)


def test_calibration_with_forces_that_are_gone_is_replaced_at_the_first_window(tmp_path: Path) -> None:
    """What shook the machine then does not now: intervals are those of a file that knows nothing."""
    config, db = learning(tmp_path), tmp_path / "rig.db"
    v = healthy(np.random.default_rng(8), 3000, 5e-6)
    still = recording(tmp_path / "still.npz", v)
    replay(config=config, recordings=[disturbed(tmp_path)], db=db)
    known = replay(config=config, recordings=[still], db=db)["estimates"]
    fresh = replay(config=config, recordings=[still], db=tmp_path / "fresh.db")["estimates"]
    (_, before), (_, now) = stored(db)
    with sqlite3.connect(db) as base:
        events = base.execute("SELECT cause, message FROM v_events WHERE source = 'calibration'").fetchall()
    assert [cause for cause, _ in events] == ["found", "adopted", "replaced"]
    assert "unknown forces: none; before: noise of the sensors: x1 " in events[2][1]
    assert max(before["process"]) > 0.3
    assert max(now["process"]) == 0.0
    for name in NAMES:
        assert known[name]["status"] == "valid"
        assert known[name]["sd"] == pytest.approx(fresh[name]["sd"], rel=0.05)


def run_info(**changes: str) -> RunInfo:
    fields: dict[str, Any] = {"rig": "rig", "kind": "live", "started_ns": 1, "code_version": "1", "config_sha256": "aa"}
    return RunInfo(**(fields | changes))


def test_store_gives_a_calibration_to_runs_of_its_kind_only(tmp_path: Path) -> None:
    newer = Calibrated((2e-6, 3e-6), (0.0, 0.6), None, searched=False)
    with Store.open(tmp_path / "rig.db") as store:
        run_id = store.begin_run(run_info())
        store.write(run_id, [CalibrationRecord("rig", 5, newer)])
        store.write(run_id, [CalibrationRecord("rig", 6, KNOWN)])
    with Store.open(tmp_path / "rig.db") as store:
        assert store.calibration(run_info()) == KNOWN
        for other in ({"rig": "other"}, {"kind": "replay"}, {"config_sha256": "bb"}, {"code_version": "2"}):
            assert store.calibration(run_info(**other)) is None
        again = store.begin_run(run_info())
        assert store.calibration(run_info()) == KNOWN
        store.write(again, [CalibrationRecord("rig", 7, newer)])
        assert store.calibration(run_info()) == newer
    assert [run for run, _ in stored(tmp_path / "rig.db")] == [run_id, again]


def test_live_rig_begins_with_what_the_run_before_knew_and_says_only_what_is_new(tmp_path: Path) -> None:
    config = load(ROOT / "deploy/examples/modbus.toml")
    name = config.rig.name
    db, info = tmp_path / "rig.db", run_info(rig=name, config_sha256=config.sha256)
    with Store.open(db) as store:
        store.write(store.begin_run(info), [CalibrationRecord(name, 5, KNOWN)])
    writer = StoreWriter(lambda: Store.open(db), [info])
    writer.start()
    writer.stop()
    published: list[Record] = []
    rig = RigRuntime(config, published.extend)
    rig.restore([], writer.calibrations[name])
    contained = rig.pipeline.estimation.estimator
    assert isinstance(contained, ContainedEstimator)
    estimator = contained.estimator
    assert isinstance(estimator, WindowML)
    found = estimator.point.calibrated(searched=True)
    # what the configuration states of the noise is believed (and the wire's steps added)
    assert (found.process, found.factor) == (KNOWN.process, KNOWN.factor)
    assert found.sigma == pytest.approx((1.15e-6, 1.15e-6), rel=0.01)
    assert not [record for record in published if isinstance(record, CalibrationRecord)]
