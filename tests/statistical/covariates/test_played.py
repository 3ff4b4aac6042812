"""Days of a rig in virtual time, sample by sample: a motion burst each 2 h, springs that follow the hall."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.cli.commissioning.limits import proposed
from agent.commissioning.baseline.learn import Stretch, learn
from agent.runtime.replay import replay
from tests.scenario.test_bad_input import configuration
from tests.statistical.covariates.year import DAY, LAG_S, PER_KELVIN, STEP_S, first_order
from tests.statistical.machine import NOMINAL, SECOND, Machine, on_second
from tests.statistical.operation import drive

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]
NOISE_M = 1e-5
BURST_S, EVERY_H = 2, 2
HALL = """
[[channel]]
name = "hall"
role = "covariate"
quantity = "temperature"
unit = "degC"
[baseline]
classes = 3
[estimator]
"""


def days(path: Path, seed: int, first: float, last: float, lost: float = 0.0) -> Path:
    """A recording of days first to last of one summer out of doors: a reading of the hall in each burst."""
    rng = np.random.default_rng([seed, 3])
    t = np.arange(12 * DAY) / DAY
    hall = 20.0 + 15.0 * np.sin(2 * np.pi * t) + 3.0 * np.sin(2 * np.pi * t / 3.7)
    lagged = first_order(hall, LAG_S / STEP_S)
    parts = []
    for hour in range(round(24 * first), round(24 * last), EVERY_H):
        now = 6 * hour
        rig = Machine.at_rest()
        factor = 1.0 + PER_KELVIN * (lagged[now] - 20.0)
        rig.theta = NOMINAL * np.array([factor * (1.0 - lost), factor, 1.0, 1.0])
        force = drive(rng, BURST_S * SECOND + 1)
        y = rig.play(on_second(force))[:, :2]
        y = y + NOISE_M * rng.standard_normal(y.shape)
        t = 3600.0 * hour + np.arange(len(y)) / SECOND
        read = np.full(len(y), np.nan)
        read[::1000] = hall[now] + 0.05 * rng.standard_normal(len(read[::1000]))
        parts.append(np.column_stack([t, force[: len(y)], y, read]))
    whole = np.vstack(parts)
    np.savez(path, t=whole[:, 0], force=whole[:, 1], x1=whole[:, 2], x2=whole[:, 3], hall=whole[:, 4])
    return path


def levels(document: dict[str, Any]) -> list[str]:
    return [alarm["parameter"] for alarm in document["alarms"] if alarm["kind"] == "level"]


def test_days_of_samples_raise_nothing_compensated_and_find_a_loss(tmp_path: Path) -> None:
    changes = {"[estimator]": HALL, 'clock = "counter"': 'clock = "device"',
               "limit_percent = 10.0": "limit_percent = 3.0"}  # fmt: skip
    config, db = configuration(tmp_path, 0.5, **changes), tmp_path / "rig.db"
    plain = replay(config=config, recordings=[days(tmp_path / "a.npz", 0, 0, 4)], db=db)
    assert "k1" in levels(plain)
    found = learn(db, None, Stretch(("k1", "k2"), hours=48.0))["parameters"]
    for name in ("k1", "k2"):
        (one,) = found[name]["covariates"]
        assert one["used"]
        assert one["coefficient"] == pytest.approx(PER_KELVIN * found[name]["reference"], rel=0.15)
    healthy = replay(config=config, recordings=[days(tmp_path / "b.npz", 1, 4, 5.5)], db=db)
    assert [name for name in levels(healthy) if name in found] == []
    lost = replay(config=config, recordings=[days(tmp_path / "c.npz", 2, 5.5, 6, lost=0.05)], db=db)
    assert "k1" in levels(lost)
    assert "k2" not in levels(lost)
    limits = proposed(db, None, 1.0, config, write=False)["parameters"]
    assert limits["k1"]["limit"] < 0.03 * NOMINAL[0]
