"""An input that is commanded in two levels is known exactly: the step between them is no resolution of a
wire."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.rig_model import rig_model
from agent.config import load
from agent.numerics.model.statespace import discretise, simulate
from agent.runtime.replay import replay
from tests.peers import ROOT

TANKS = ROOT / "deploy/examples/coupled_tanks.toml"
TRUE = {"c12": 0.0044, "c2": 0.0021}


def recording(folder: Path) -> Path:
    """Two tanks whose pump is switched on and off, their sensors noisy as the configuration says."""
    config, rng = load(TANKS), np.random.default_rng(3)
    model, rate = rig_model(config).model, config.rig.sample_rate_hz
    pump = np.repeat(rng.choice([0.0, 1e-3], 20), 100)
    sampled = discretise(
        model.continuous(np.array([TRUE[name] for name in model.parameters])), 1.0 / rate, "zero"
    )
    levels = simulate(sampled, np.zeros(sampled.model.n), pump[:, None])[1]
    noise = [(channel.noise_sd or 0.0) * channel.si_factor for channel in config.outputs]
    levels += np.array(noise) * rng.standard_normal(levels.shape)
    names = [channel.name for channel in (*config.inputs, *config.outputs)]
    path = folder / "tanks.npz"
    np.savez(path, t=np.arange(len(pump)) / rate, **dict(zip(names, (pump, *levels.T), strict=True)))
    return path


def test_input_switched_between_two_levels_gives_intervals_of_its_information(tmp_path: Path) -> None:
    rows = replay(config=TANKS, recordings=[recording(tmp_path)], db=None)["estimates"]
    for name, true in TRUE.items():
        row = rows[name]
        assert row["status"] == "valid"
        assert row["sd"] < 2e-3 * true  # a pump known to 1e-3 / sqrt(12) only would make it 7e-3
        assert row["value"] == pytest.approx(true, abs=4 * row["sd"])
