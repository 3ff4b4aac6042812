"""A sensor that reads 5 % high: `gain = true` finds it through the whole configuration, or check says why it
cannot."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.config import RigConfig, load
from agent.runtime.assembly.methods import make_estimation
from agent.runtime.assembly.model_check import model_faults
from agent.types import Samples, Status
from tests.bench.scene import NOMINAL, play

SCENE = Path(__file__).parents[2] / "bench" / "scene.toml"
FORCE = '[[channel]]\nname = "force"\nquantity = "force"\nat = "m2"\nunit = "N"\n'


def configured(folder: Path, *channels: str, forced: bool = True) -> RigConfig:
    """The comparison's rig in a window of 2 s, with the gains of some channels unknown."""
    text = SCENE.read_text(encoding="utf-8").replace("@NOISE@", "1e-6").replace("@WINDOW@", "2.0")
    for channel in channels:
        text = text.replace(f'name = "{channel}"\n', f'name = "{channel}"\ngain = true\n')
    path = folder / "rig.toml"
    path.write_text(text if forced else text.replace(FORCE, ""), encoding="utf-8")
    return load(path)


@pytest.mark.parametrize(
    ("channels", "sd", "sd_gain"),
    [
        # the force's gain is as configured: a fiftieth of its data sheet's 1 %, a sixth of that from the
        # noise, and what is left of the hypotheses that data sheets are wider
        (("x1",), 2.5e-4, 2.8e-4),
        # both masses and the force by 1 %, both motions by -1 %: no reading differs, so data sheets alone say
        # what the scale is: two masses of 2 % each, and the force of 1 % beside them
        (("x1", "x2"), 1.05 * 0.02 / 2**0.5, 1.05 * (0.02**2 / 2 + 0.01**2) ** 0.5),
    ],
    ids=["its own", "both outputs'"],
)
def test_window_ml_recovers_a_gain_error_of_five_percent_beside_the_stiffness(
    tmp_path: Path, channels: tuple[str, ...], sd: float, sd_gain: float
) -> None:
    record = play(np.tile(NOMINAL, (6000, 1)), 1e-6, np.random.default_rng(5))
    index = np.arange(len(record.y))
    config = configured(tmp_path, *channels)
    samples = Samples(index, index * 1_000_000, record.u, record.y * [1.05, 1.0], segment=0)
    batch = make_estimation(config, np.zeros(2)).step(samples).batch
    assert batch is not None
    expected = np.array([*NOMINAL, 1.05, 1.0][: len(NOMINAL) + len(channels)])
    assert batch.parameters[4:] == tuple(f"{channel}.gain" for channel in channels)
    assert np.all(batch.status[-1] == Status.VALID)
    assert np.all(np.abs(batch.value[-1] - expected) < 5 * batch.sd[-1])
    assert np.all(batch.sd[-1] < expected * np.array([*[sd] * 4, *[sd_gain] * len(channels)]))


def test_window_ml_a_gain_error_that_is_not_asked_for_is_found_among_the_constants_and_moves_no_estimate(
    tmp_path: Path,
) -> None:
    record = play(np.tile(NOMINAL, (6000, 1)), 1e-6, np.random.default_rng(5))
    index = np.arange(len(record.y))
    samples = Samples(index, index * 1_000_000, record.u, record.y * [1.05, 1.0], segment=0)
    estimation = make_estimation(configured(tmp_path), np.zeros(2))
    estimated = estimation.step(samples)
    batch = estimated.batch
    assert batch is not None
    valid = (batch.status == Status.VALID).all(axis=1)
    assert valid[-1]
    # one window alone cannot tell a gain that is off from one that drifts, and its sds of 3e-5 are too small
    # for what it is off by, at most as much as the force's gain leaves open in every later row: 2e-4
    assert np.all((np.abs(batch.value - NOMINAL) < 5 * np.maximum(batch.sd, 2e-4 * NOMINAL))[valid])
    _, believed = estimated.beliefs[-1]
    (off,) = [belief for belief in believed if belief.probability > 0.9]
    assert (off.name, off.kind) == ("x1", "output")
    assert abs(off.size - 0.05) < 5 * off.sd < 5e-3


@pytest.mark.parametrize(
    ("channels", "forced", "named"),
    [
        (("force", "x1", "x2"), True, '"force.gain", "x1.gain" and "x2.gain" cannot be told apart'),
        (("x1", "x2"), False, '"x1.gain" and "x2.gain" cannot be told apart'),
    ],
    ids=["all gains", "free decay"],
)
def test_model_faults_gains_that_nothing_tells_apart_are_named_with_a_way_out(
    tmp_path: Path, channels: tuple[str, ...], forced: bool, named: str
) -> None:
    config = configured(tmp_path, *channels, forced=forced)
    (fault,) = model_faults(config, rig_model(config))
    assert fault.message.startswith(named)
    assert "changes no reading" in fault.message
    assert "check one of these sensors against a load or a length that is known" in fault.advice
    assert 'leave "x2.gain" out of the estimate' in fault.advice
