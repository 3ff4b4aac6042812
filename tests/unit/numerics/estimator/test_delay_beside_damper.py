"""A joint without mass: what its damper tells, and a delay of its load, are nearly the same."""

from pathlib import Path

import numpy as np
import pytest

from agent.blocks.contained_estimator import ContainedEstimator
from agent.blocks.statistical_rig import statistical_rig
from agent.config import load
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.runtime.pipeline import Pipeline
from agent.types import FloatArray
from drivers.port import SampleBlock

RATE_HZ, CYCLES = 100.0, 200
STIFFNESS, DAMPING, LOOP = 3.5e7, 1e5, 0.02
"""N/m, N s/m, and the width of the loop that adhesive makes, a share of the largest load."""
DELAY_SD_S = 0.0025
"""Stated: of a rig without mass no delay is looked for otherwise, since dampers do the same."""
EVALUATIONS = 10
"""Of the model a window, at most: 8.3, and 13 where descents creep to their last step."""
TEXT = f"""
[rig]
name = "joint"
sample_rate_hz = {RATE_HZ}
clock = "counter"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m", value = 0.0 }}]
spring = [{{ name = "k", between = ["ground", "m"], nominal = {STIFFNESS} }}]
damper = [{{ name = "B", between = ["ground", "m"], nominal = 2e5 }}]
[[channel]]
name = "load"
quantity = "force"
at = "m"
unit = "N"
delay_sd_s = {DELAY_SD_S}
[[channel]]
name = "x"
quantity = "displacement"
at = "m"
unit = "m"
[estimator]
window_s = 2.0
hop_s = 1.0
"""


def readings(rng: np.random.Generator) -> FloatArray:
    """(N, 2) loads, N, and displacements, m: a period a second, with harmonics of a test bench."""
    t = np.arange(int(CYCLES * RATE_HZ)) / RATE_HZ
    harmonics = [(1, 1e-4, 0.0), (3, 1e-5, 0.4), (5, 4e-6, 1.1)]

    def motion(t: FloatArray) -> FloatArray:
        return np.sum([a * np.sin(2 * np.pi * n * t + phase) for n, a, phase in harmonics], axis=0)

    speed = (motion(t + 1e-6) - motion(t - 1e-6)) / 2e-6
    load = STIFFNESS * motion(t) + DAMPING * speed + LOOP * STIFFNESS * 1e-4 * np.tanh(speed / 1e-4)
    return np.column_stack([load, motion(t)]) + rng.standard_normal((len(t), 2)) * [1.0, 5e-7]


def test_windows_are_learnt_from_at_the_usual_cost(tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.write_text(TEXT, encoding="utf-8")
    pipeline = Pipeline(load(path), {}, {"recording": {"load": "load", "x": "x"}})
    v = readings(np.random.default_rng(2))
    for start in range(0, len(v), 1000):
        counter = np.arange(start, start + 1000, dtype=np.int64)
        block = SampleBlock(v[start : start + 1000], (start + 1000) * 10**7, counter)
        pipeline.step("recording", block, None, None)
    contained = pipeline.stages.estimation.estimator
    assert isinstance(contained, ContainedEstimator)
    assert isinstance(contained.estimator, SlidingEstimator)
    explainer = contained.estimator.explainer
    assert explainer.known is not None
    assert explainer.known.noise.windows > 30
    assert explainer.learner.lineariser.evaluations < EVALUATIONS * explainer.known.noise.windows


def test_rig_without_mass_has_no_delay_unless_one_is_stated(tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    found = []
    for text in (TEXT, TEXT.replace(f"delay_sd_s = {DELAY_SD_S}\n", "")):
        path.write_text(text, encoding="utf-8")
        constants = statistical_rig(load(path)).constants
        found.append([constant.sheet for constant in constants if constant.kind == "delay"])
    assert found == [[pytest.approx(DELAY_SD_S * RATE_HZ)] * 2, []]
