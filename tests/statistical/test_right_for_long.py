"""A right rig over hundreds of windows: what is known is not forgotten between windows learnt from."""

from pathlib import Path

import numpy as np

from agent.config import load
from agent.runtime.assembly.methods import make_estimation
from agent.types import Samples, Status
from tests.bench.scene import NOMINAL, play

SCENE = Path(__file__).parents[1] / "bench" / "scene.toml"
WINDOWS, WINDOW, BLOCK = 700, 1000, 50_000


def test_sds_of_a_right_rig_stay_what_they_are_over_hundreds_of_windows(tmp_path: Path) -> None:
    record = play(np.tile(NOMINAL, (WINDOWS * WINDOW, 1)), 1e-6, np.random.default_rng(3))
    path = tmp_path / "rig.toml"
    path.write_text(
        SCENE.read_text(encoding="utf-8").replace("@NOISE@", "1e-6").replace("@WINDOW@", "1.0"),
        encoding="utf-8",
    )
    estimation = make_estimation(load(path), np.zeros(2))
    sds = []
    for first in range(0, len(record.y), BLOCK):
        index = np.arange(first, first + BLOCK)
        samples = Samples(index, index * 1_000_000, record.u[index], record.y[index], segment=0)
        batch = estimation.step(samples).batch
        assert batch is not None
        valid = (batch.status == Status.VALID).all(axis=1)
        sds.append(np.median(batch.sd[valid][:, : len(NOMINAL)], axis=0))
    assert np.all(sds[-1] < 1.15 * sds[1])
