"""Limits learnt from minutes of a healthy rig, tried on other seeds and on a spring that loses what they
find."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.commissioning.limits import proposed
from agent.commissioning.baseline.learn import Stretch, learn
from agent.runtime.replay import replay
from agent.types import FloatArray
from tests.scenario.test_bad_input import configuration
from tests.statistical.machine import NAMES, NOMINAL, SECOND, Machine, on_second
from tests.statistical.operation import LOADS_N, drive
from tests.statistical.operation import NOISE_M as FULL_NOISE_M

pytestmark = pytest.mark.soak
NOISE_M = 1e-6
LEARNT_S, HEALTHY_S = 120, 240


def recording(path: Path, seed: int, seconds: int, after: FloatArray = NOMINAL) -> Path:
    """A rig at work whose springs and dampers become `after` at half time."""
    rng = np.random.default_rng([seed, 17])
    force = rng.choice(LOADS_N) + drive(rng, (10 + seconds) * SECOND + 1)
    rig = Machine.at_rest()
    half = (10 + seconds // 2) * SECOND
    y = [rig.play(on_second(force[: half + 1]))]
    rig.theta = after
    y.append(rig.play(on_second(force[half:])))
    read = np.vstack(y)[10 * SECOND :, :2]
    read = read + NOISE_M * rng.standard_normal(read.shape)
    np.savez(
        path, t=np.arange(len(read)) / SECOND, force=force[10 * SECOND : -1], x1=read[:, 0], x2=read[:, 1]
    )
    return path


def levels(document: dict[str, Any]) -> list[str]:
    return [alarm["parameter"] for alarm in document["alarms"] if alarm["kind"] == "level"]


def test_proposed_limits_raise_nothing_on_other_seeds_and_find_the_change_they_say(tmp_path: Path) -> None:
    config = configuration(tmp_path, **{f"noise_sd = {FULL_NOISE_M!r}": f"noise_sd = {NOISE_M!r}"})
    db = tmp_path / "rig.db"
    replay(config=config, recordings=[recording(tmp_path / "learnt.npz", 0, LEARNT_S)], db=db)
    learn(db, None, Stretch(hours=0.5 * LEARNT_S / 3600))
    found = proposed(db, None, 1.0, config, write=True)["parameters"]
    assert set(found) == set(NAMES)
    for seed in (1, 2):
        assert (
            levels(replay(config=config, recordings=[recording(tmp_path / "r.npz", seed, HEALTHY_S)], db=db))
            == []
        )
    weaker = NOMINAL - np.array([found["k1"]["finds"] * 1.2, 0.0, 0.0, 0.0])
    document = replay(config=config, recordings=[recording(tmp_path / "w.npz", 3, 40, weaker)], db=db)
    assert set(levels(document)) == {"k1"}
    delay_s = document["alarms"][0]["raised_ns"] / 1e9 - 20.0
    assert 0 < delay_s <= found["k1"]["finds_within_s"] + 1.0
