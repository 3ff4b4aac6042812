"""Linear rigs that the simulator plays: its own sampling against the agent's, entries that change, what is
refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.config import load
from agent.numerics.model.statespace import discretise, simulate
from sim_bus.errors import SimUsageError
from sim_bus.rig.plant import propagate, step
from sim_bus.rig.rigfile import read_rig
from sim_bus.rig.scenario import Scenario
from sim_bus.rig.trajectory import Rig
from tests.scenario.test_linear_rigs import DISCRETE
from tests.sim.rigs import ROOT


def test_voice_coil_moves_as_the_agents_model_says(rng: np.random.Generator) -> None:
    file = ROOT / "deploy/examples/voice_coil.toml"
    rig, model = read_rig(file), rig_model(load(file)).model
    values = {"R": 4.8, "k": 310.0, "b": 1.7, "K": 5.2}
    motion = rig.system.equations(rig.nominal | values)
    u = rng.standard_normal((300, 1))
    theirs = propagate(step(motion, 5e-4, "first"), np.zeros(3), u)
    h, j = motion.output("output", "position")
    ours = simulate(
        discretise(model.continuous(np.array([*values.values()])), 5e-4, "first"), np.zeros(3), u
    )[1]
    np.testing.assert_allclose(theirs @ h + u @ j, ours[:, 0], atol=1e-12 * np.abs(ours).max())


def test_entry_that_nothing_names_may_change(tmp_path: Path) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE)
    rig = read_rig(file)
    system = rig.system.equations(rig.nominal | {"B[1,0]": 0.3})
    assert (system.G.tolist(), system.F.tolist()) == ([[0.0], [0.3]], [[0.95, 0.08], [-0.08, 0.95]])


def test_matrix_in_a_file_is_played(tmp_path: Path) -> None:
    np.savez(tmp_path / "plant.npz", A=np.array([[0.9, 0.0], [0.0, 0.8]]))
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE.replace("A = [[0.95, 0.08], [-0.08, 0.95]]", 'A = { file = "plant.npz" }'))
    assert read_rig(file).nominal["A[0,0]"] == 0.9
    file.write_text(DISCRETE.replace("A = [[0.95, 0.08], [-0.08, 0.95]]", 'A = { file = "none.npz" }'))
    with pytest.raises(SimUsageError, match=r"model\.A"):
        read_rig(file)


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("B = [[0.0], [0.1]]", "B = [[0.0, 0.1]]", "B has 1 rows of 2"),
        ("[0.0, 1.0]]", "[1.0]]", "rows of different length"),
        ('quantity = "input"', 'quantity = "force"', 'quantity "input" or "output"'),
    ],
)
def test_linear_rig_that_cannot_be_played_says_why(
    tmp_path: Path, before: str, after: str, words: str
) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE.replace(before, after, 1))
    with pytest.raises(SimUsageError) as caught:
        read_rig(file)
    assert words in json.dumps(caught.value.lines).replace('\\"', '"')


def test_delay_of_part_of_a_sample_is_refused_in_discrete_time(tmp_path: Path) -> None:
    file = tmp_path / "loop.toml"
    file.write_text(DISCRETE.replace('name = "y1"\n', 'name = "y1"\ndelay_s = 0.004\n', 1))
    with pytest.raises(SimUsageError, match="whole samples"):
        Rig(read_rig(file), Scenario()).advance(2)
