"""The paper's method in the agent: chosen by name in a configuration, seen through the estimation block."""

from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.runtime.assembly.methods import make_estimation
from agent.types import EstimateBatch, Reason, Samples, Status
from tests.bench.scene import NOMINAL, Record, play

TEMPLATE = Path(__file__).parents[2] / "bench" / "scene.toml"
CHANGE = np.array([4.0, -8.0, 0.8, -0.5])


@pytest.fixture(scope="module")
def record() -> Record:
    return play(np.tile(NOMINAL + CHANGE, (3000, 1)), 0.0, np.random.default_rng(5))


def estimates(folder: Path, record: Record, passes: int) -> EstimateBatch:
    method = f"""method = "seed"
passes = {passes}
observer = {{ gain = "poles", poles = [-90.0, -80.0, -70.0, -60.0] }}
window_s"""
    text = TEMPLATE.read_text(encoding="utf-8").replace("window_s", method, 1)
    file = folder / "seed.toml"
    file.write_text(text.replace("@NOISE@", "1e-6").replace("@WINDOW@", "0.5"), encoding="utf-8")
    block = make_estimation(load(file), np.zeros(2))
    index = np.arange(len(record.y), dtype=np.int64)
    found = block.step(Samples(index, index * 1_000_000, record.u, record.y, segment=0)).batch
    assert found is not None
    return found


def test_seed_method_recentred_gives_valid_estimates_at_the_true_values(
    tmp_path: Path, record: Record
) -> None:
    found = estimates(tmp_path, record, passes=20)
    assert found.method == "seed"
    assert np.all(found.status[-1] == Status.VALID)
    assert np.allclose(found.value[-1], NOMINAL + CHANGE, rtol=1e-3)
    assert np.all(found.lower[-1] <= found.upper[-1])


def test_seed_method_as_printed_has_not_settled_and_is_diverged(tmp_path: Path, record: Record) -> None:
    found = estimates(tmp_path, record, passes=1)
    whole = found.status[:, 0] != Status.WARMING
    assert whole.sum() > 20
    assert np.all(found.status[whole] == Status.INVALID)
    assert np.all(found.reason[whole] == Reason.DIVERGED)


def test_seed_method_before_its_observer_has_settled_is_warming(tmp_path: Path, record: Record) -> None:
    found = estimates(tmp_path, record, passes=1)
    assert np.all(found.status[found.index < 500] == Status.WARMING)
    assert np.all(np.isnan(found.value[found.index < 500]))
