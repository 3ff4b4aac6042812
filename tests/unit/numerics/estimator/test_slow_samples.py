"""A spring that wears by half while it is read slowly, a cycle a window: rows follow it to the end."""

from pathlib import Path

import numpy as np

from agent.config import load
from agent.records import Record
from agent.runtime.pipeline import Pipeline
from agent.types import EstimateBatch, FloatArray, Status
from drivers.port import SampleBlock

RATE, CYCLES, FINE = 100, 380, 10
K, B = 35e6, 0.3e6
HARDENING = 0.04
"""Share of the displacement's square, in mm, that the spring is stiffer by: what no window's model has."""
CONFIG = f"""
[rig]
name = "joint"
sample_rate_hz = {RATE}.0
clock = "uniform"
[model]
kind = "mass-spring-damper"
mass = [{{ name = "m", value = 0.0 }}]
spring = [{{ name = "k", between = ["ground", "m"], nominal = {K} }}]
damper = [{{ name = "B", between = ["ground", "m"], nominal = {B} }}]
[[channel]]
name = "force"
quantity = "force"
at = "m"
unit = "kN"
[[channel]]
name = "x"
quantity = "displacement"
at = "m"
unit = "mm"
[estimator]
window_s = 1.0
hop_s = 1.0
[[alarm]]
parameter = "k"
limit_percent = 10.0
"""


def stiffness() -> FloatArray:
    """(CYCLES,) N/m: slow at first, then ever faster, as joints and cracks go."""
    life = np.arange(CYCLES) / CYCLES
    return np.asarray(K * (1 - 0.1 * life - 0.45 * life**8))


def readings() -> FloatArray:
    """(CYCLES RATE, 2) force, kN, and displacement, mm, of B ẋ + k (1 + h x²) x = F, by fine Euler steps."""
    rng = np.random.default_rng(4)
    step = 1 / (RATE * FINE)
    force = 10.0 * np.sin(2 * np.pi * np.arange(CYCLES * RATE * FINE) * step)
    k = np.repeat(stiffness(), RATE * FINE)
    x, found = 0.0, np.empty(len(force))
    for i, (f, stiff) in enumerate(zip((force * 1e3).tolist(), k.tolist(), strict=True)):
        found[i] = x
        x += step * (f - stiff * (1 + HARDENING * (1e3 * x) ** 2) * x) / B
    v = np.column_stack([force, 1e3 * found])[::FINE]
    return np.asarray(v + [0.002, 1e-4] * rng.standard_normal(v.shape))


def rows(records: list[Record]) -> list[tuple[int, float, float]]:
    """Status, value and sd of k in each row."""
    batches = [r for r in records if isinstance(r, EstimateBatch)]
    return [
        (int(s[0]), float(v[0]), float(w[0]))
        for batch in batches
        for s, v, w in zip(batch.status, batch.value, batch.sd, strict=True)
    ]


def test_spring_that_wears_by_half_is_followed_where_windows_have_few_samples(tmp_path: Path) -> None:
    path = tmp_path / "joint.toml"
    path.write_text(CONFIG, encoding="utf-8")
    pipeline = Pipeline(load(path), {}, {"recording": {"force": "force", "x": "x"}})
    v = readings()
    t_ns = np.arange(len(v)) * (10**9 // RATE)
    found = rows([*pipeline.step("recording", SampleBlock(v, 0, None, t_ns), None, None), *pipeline.finish()])
    status, value, sd = (np.array(part)[250:] for part in zip(*found, strict=True))
    valid = status == Status.VALID
    assert np.mean(valid) >= 0.9
    error = np.abs(value - stiffness()[250:])
    assert np.all((error < 1.96 * sd)[valid])
    # the last ten cycles cost a sixth of k; rows that wait for the budget say how far off they may be
    ends, shares = np.arange(len(valid)) >= len(valid) - 10, error / stiffness()[250:]
    assert np.max(shares[valid & ~ends]) < 0.01
    assert np.max((sd / value)[valid & ~ends]) < 0.02
    assert np.max(shares[valid]) < 0.05
