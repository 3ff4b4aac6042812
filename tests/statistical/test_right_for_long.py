"""A right rig over hundreds of windows: what is known is not forgotten between windows learnt from."""

from pathlib import Path

import numpy as np

from agent.blocks.estimation import Estimation
from agent.config import load
from agent.runtime.assembly.methods import make_estimation
from agent.types import FloatArray, Samples, Status
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import load_scenario
from sim_bus.rig.trajectory import Rig, Trajectory
from sim_bus.tuning import CHUNK
from tests.bench.scene import NOMINAL, play
from tests.unit.numerics.rigs import record, sampled

EXAMPLE = Path(__file__).parents[2] / "deploy" / "examples" / "can.toml"
SCENE = Path(__file__).parents[1] / "bench" / "scene.toml"
CODE = np.array([1e-3, 2e-6, 2e-6])
"""Of the frame in deploy/examples/two-mass-rig.dbc: N, m, m."""
WINDOWS, WINDOW, BLOCK = 700, 1000, 50_000


def estimation_of(tmp_path: Path) -> Estimation:
    path = tmp_path / "rig.toml"
    path.write_text(
        SCENE.read_text(encoding="utf-8").replace("@NOISE@", "1e-6").replace("@WINDOW@", "1.0"),
        encoding="utf-8",
    )
    return make_estimation(load(path), np.zeros(2))


def samples_of(first: int, y: FloatArray, u: FloatArray) -> Samples:
    index = np.arange(first, min(first + BLOCK, len(y)))
    return Samples(index, index * 1_000_000, u[index], y[index], segment=0)


def test_sds_of_a_right_rig_stay_what_they_are_over_hundreds_of_windows(tmp_path: Path) -> None:
    made = play(np.tile(NOMINAL, (WINDOWS * WINDOW, 1)), 1e-6, np.random.default_rng(3))
    estimation = estimation_of(tmp_path)
    sds = []
    for first in range(0, len(made.y), BLOCK):
        batch = estimation.step(samples_of(first, made.y, made.u)).batch
        assert batch is not None
        valid = (batch.status == Status.VALID).all(axis=1)
        sds.append(np.median(batch.sd[valid][:, : len(NOMINAL)], axis=0))
    assert np.all(sds[-1] < 1.15 * sds[1])


def test_windows_that_differ_in_what_they_tell_of_constants_show_no_change_of_noise(tmp_path: Path) -> None:
    """A force that is held for a tenth of a window moves the rig otherwise in each: it shows its constants
    otherwise."""
    rng = np.random.default_rng(2)
    force = np.repeat(5.0 * rng.standard_normal(10_000), 100)[:130_000, None]
    truth = record(sampled(), force)
    y = truth.y + 1e-6 * rng.standard_normal(truth.y.shape)
    estimation = estimation_of(tmp_path)
    for first in range(0, len(y), BLOCK):
        estimation.step(samples_of(first, y, truth.u))
    known = estimation.estimator.estimator.explainer.known
    # noise that seems to change has eight windows in a row learnt from anew: it did four times
    assert known.noise.windows < 45


def test_windows_that_differ_in_what_they_tell_of_parameters_do_not_carry_the_point_about() -> None:
    """Of a quarter of a second each knows other directions well, and hardly anything of the rest."""
    trajectory = Trajectory(Rig(read_rig(EXAMPLE), load_scenario("steady", {})))
    estimation = make_estimation(load(EXAMPLE), np.zeros(2))
    first = 0
    while first < 60_000:
        readings = CODE * np.rint(trajectory.chunk(first // CHUNK).readings / CODE)
        index = np.arange(first, first + len(readings))
        samples = Samples(index, index * 1_000_000, readings[:, :1], readings[:, 1:], segment=0)
        estimation.step(samples)
        first += len(readings)
    explainer = estimation.estimator.estimator.explainer
    assert explainer.solved - explainer.schedule.learnt < 8
