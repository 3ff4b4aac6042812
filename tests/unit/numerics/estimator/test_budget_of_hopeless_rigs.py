"""What a rig that nothing fits may evaluate is bounded, whatever its tries come to."""

from pathlib import Path

import numpy as np

from agent.blocks.contained_estimator import ContainedEstimator
from agent.config import load
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.estimator.tuning import BURST, FIRST, LONGEST, SAMPLES_AN_EVALUATION
from agent.runtime.pipeline import Pipeline
from drivers.port import SampleBlock
from tests.scenario.live import example
from tests.unit.numerics.rigs import noisy

SAMPLES = 20_000
ENDS = 30
"""Evaluations in which a try ends that goes no further: each descent that is still begun makes one."""


def test_wrong_graph_evaluates_no_more_than_its_budget_however_many_windows_it_solves(tmp_path: Path) -> None:
    path = example("modbus", tmp_path)
    text = path.read_text(encoding="utf-8")
    right, wrong = ('between = ["m1", "m2"], nominal = 100.0', 'between = ["ground", "m2"], nominal = 100.0')
    assert right in text
    path.write_text(text.replace(right, wrong), encoding="utf-8")
    config = load(path)
    pipeline = Pipeline(config, {}, {source.name: source.map for source in config.source})
    v = noisy(np.random.default_rng(1), SAMPLES, 1e-6).v[:, [2, 0, 1]]
    for start in range(0, SAMPLES, 1000):
        counter = np.arange(start, start + 1000, dtype=np.int64)
        pipeline.step(
            "modbus", SampleBlock(v[start : start + 1000], (start + 1000) * 10**6, counter), None, None
        )
    contained = pipeline.stages.estimation.estimator
    assert isinstance(contained, ContainedEstimator)
    assert isinstance(contained.estimator, SlidingEstimator)
    done = contained.estimator.explainer.learner.lineariser.evaluations
    assert done <= BURST + FIRST + SAMPLES / SAMPLES_AN_EVALUATION + LONGEST + ENDS
