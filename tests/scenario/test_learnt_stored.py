"""What was learnt of a rig outlives the process: the next run begins with it, another rig does not."""

import base64
import json
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.runtime.replay import replay
from tests.scenario.test_bad_input import configuration
from tests.statistical.machine import NAMES
from tests.statistical.operation import NOISE_M
from tests.statistical.sensor_faults import healthy


def recording(path: Path, columns: np.ndarray[Any, Any]) -> Path:
    force, x1, x2 = columns.T
    np.savez(path, t=1e-3 * np.arange(len(force)), force=force, x1=x1, x2=x2)
    return path


def learning(folder: Path, window_s: float = 1.0) -> Path:
    """A configuration that does not say how noisy the sensors are."""
    return configuration(folder, window_s, **{f"noise_sd = {NOISE_M!r}": ""})


def stored(db: Path) -> list[tuple[int, dict[str, Any]]]:
    """(run, content) of everything learnt in a file."""
    with sqlite3.connect(db) as base:
        return [(run, json.loads(text)) for run, text in base.execute("SELECT run_id, content FROM learnt")]


def sigma(content: dict[str, Any]) -> float:
    """The sd of the first sensor."""
    kept = base64.b64decode(content["noise"]["log_sigma"]["base64"])
    return float(np.exp(np.frombuffer(kept, dtype="<f8")[0]))


def test_replay_begins_with_what_the_run_before_learnt(tmp_path: Path) -> None:
    config, db = learning(tmp_path), tmp_path / "rig.db"
    record = recording(tmp_path / "fine.npz", healthy(np.random.default_rng(4), 8000, 1e-6))
    first = replay(config=config, recordings=[record], db=db)
    before = stored(db)
    assert {run for run, _ in before} == {first["run_id"]}
    assert sigma(before[-1][1]) == pytest.approx(1e-6, rel=0.2)
    second = replay(config=config, recordings=[record], db=db)
    after = [content for run, content in stored(db) if run == second["run_id"]]
    assert after[-1]["noise"]["windows"] > before[-1][1]["noise"]["windows"]
    for name in NAMES:
        assert second["estimates"][name]["status"] == "valid"


def test_edit_of_another_part_keeps_what_was_learnt(tmp_path: Path) -> None:
    config, db = learning(tmp_path), tmp_path / "rig.db"
    record = recording(tmp_path / "fine.npz", healthy(np.random.default_rng(4), 8000, 1e-6))
    replay(config=config, recordings=[record], db=db)
    learnt = max(content["noise"]["windows"] for _, content in stored(db))
    config.write_text(config.read_text(encoding="utf-8") + "# mended\n", encoding="utf-8")
    run = replay(config=config, recordings=[record], db=db)["run_id"]
    assert max(content["noise"]["windows"] for r, content in stored(db) if r == run) > learnt


def test_knowledge_that_does_not_explain_the_rig_is_learnt_anew(tmp_path: Path) -> None:
    """A sensor was replaced by a worse one: what was known of its noise must not stop everything."""
    config, db = learning(tmp_path), tmp_path / "rig.db"
    v = healthy(np.random.default_rng(6), 8000, 1e-6)
    replay(config=config, recordings=[recording(tmp_path / "fine.npz", v)], db=db)
    v[:, 1:] += 5e-5 * np.random.default_rng(7).standard_normal((len(v), 2))
    document = replay(config=config, recordings=[recording(tmp_path / "rough.npz", v)], db=db)
    assert {row["status"] for row in document["estimates"].values()} == {"valid"}
    assert sigma(stored(db)[-1][1]) == pytest.approx(5e-5, rel=0.2)
