"""What a sample costs on a rig with a hopeless configuration, against the same samples rightly configured."""

import time
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.runtime.pipeline import Pipeline
from drivers.port import SampleBlock
from tests.figures import figure
from tests.scenario.live import example
from tests.unit.numerics.rigs import noisy

pytestmark = pytest.mark.bench

SPENT, BLOCK, SAMPLES = 20_000, 100, 200_000
"""Samples by which the capital is spent, those of a block as a bus delivers them, and those that are timed.
"""


def cost_us(path: Path, v: np.ndarray) -> float:
    """Microseconds of processor time a sample, from block to rows, after the capital is spent."""
    config = load(path)
    pipeline, begun = Pipeline(config, {}, {source.name: source.map for source in config.source}), 0.0
    for start in range(0, SPENT + SAMPLES, BLOCK):
        begun = time.process_time() if start == SPENT else begun
        counter = np.arange(start, start + BLOCK, dtype=np.int64)
        pipeline.step(
            "modbus", SampleBlock(v[start : start + BLOCK], (start + BLOCK) * 1_000_000, counter), None, None
        )
    return 1e6 * (time.process_time() - begun) / SAMPLES


def test_hopeless_rig_costs_at_most_five_times_the_right_one_once_its_capital_is_spent(
    tmp_path: Path,
) -> None:
    v = noisy(np.random.default_rng(1), SPENT + SAMPLES, 1e-6).v[:, [2, 0, 1]]
    path = example("modbus", tmp_path)
    right = cost_us(path, v)
    text = path.read_text(encoding="utf-8")
    wrong = text.replace("nominal = 25.0", "nominal = 1.0").replace("nominal = 100.0", "nominal = 1.0")
    path.write_text(wrong, encoding="utf-8")
    hopeless = cost_us(path, v)
    figure(
        f"a hopeless rig: {hopeless:.1f} us a sample, {hopeless / right:.1f} x the right one's {right:.1f}"
    )
    assert hopeless <= 5.0 * right


FIRST = 60_000
WRONG = {
    "nominals of 1": [("nominal = 25.0", "nominal = 1.0"), ("nominal = 100.0", "nominal = 1.0")],
    "a wrong graph": [
        ('between = ["m1", "m2"], nominal = 100.0', 'between = ["ground", "m2"], nominal = 100.0')
    ],
    "a force at the wrong mass": [('at = "m2"\nunit = "N"', 'at = "m1"\nunit = "N"')],
    "a force of the wrong sign": [('unit = "N"', 'unit = "N"\nscale = -1.0')],
    "lengths a thousand times too small": [('unit = "m"', 'unit = "mm"')],
}


@pytest.mark.parametrize("wrong", list(WRONG))
def test_first_minute_of_a_hopeless_rig_costs_at_most_three_times_the_right_one(
    wrong: str, tmp_path: Path
) -> None:
    v = noisy(np.random.default_rng(1), FIRST, 1e-6).v[:, [2, 0, 1]]
    path = example("modbus", tmp_path)
    right = first_minute_us(path, v)
    text = path.read_text(encoding="utf-8")
    for old, new in WRONG[wrong]:
        assert old in text
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    hopeless = first_minute_us(path, v)
    figure(
        f"first minute of {wrong}: {hopeless:.0f} us a sample, "
        f"{hopeless / right:.1f} x the right one's {right:.0f}"
    )
    assert hopeless <= 3.0 * right


def first_minute_us(path: Path, v: np.ndarray) -> float:
    """Microseconds of processor time a sample over a whole recording, from its first one on."""
    config = load(path)
    pipeline, begun = (
        Pipeline(config, {}, {source.name: source.map for source in config.source}),
        time.process_time(),
    )
    for start in range(0, len(v), BLOCK):
        counter = np.arange(start, start + BLOCK, dtype=np.int64)
        pipeline.step(
            "modbus", SampleBlock(v[start : start + BLOCK], (start + BLOCK) * 1_000_000, counter), None, None
        )
    return 1e6 * (time.process_time() - begun) / len(v)
