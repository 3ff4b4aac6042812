"""Clocks of devices from when their samples arrive: the drift, its interval, restarts and long runs."""

import numpy as np
import pytest

from agent.numerics.preprocessing.drift import ClockFit, lower_line
from agent.numerics.preprocessing.tuning import BINS

PERIODS = {"polled": 0.02, "streamed": 0.002}


def fitted(seed: int, ppm: float, span_s: float, kind: str) -> ClockFit:
    """A device at 1 kHz whose clock gains ppm, read by polls or as it sends, with delays that are never
    negative."""
    rng, fit = np.random.default_rng(seed), ClockFit(1000.0)
    t = np.cumsum(PERIODS[kind] * (1 + 0.2 * rng.random(round(span_s / PERIODS[kind]))))
    mean = {"polled": 0.003, "streamed": 0.0005}[kind]
    late = 0.001 + rng.exponential(mean, len(t)) + np.where(rng.random(len(t)) < 0.01, 0.1, 0.0)
    for index, arrival in zip(
        (t * (1 + ppm * 1e-6) * 1000).astype(int).tolist(), (t + late).tolist(), strict=True
    ):
        fit.observe(index, round(arrival * 1e9) + 10**15)
    return fit


@pytest.mark.parametrize("kind", sorted(PERIODS))
def test_drift_interval_holds_the_truth(kind: str) -> None:
    found = [drift for seed in range(25) if (drift := fitted(seed, 80.0, 20.0, kind).drift()) is not None]
    assert len(found) == 25
    assert sum(abs(drift.ppm - 80.0) < 1.96 * drift.sd for drift in found) >= 22
    assert np.median([drift.sd for drift in found]) < 25.0


def test_drift_of_a_minute_is_known_to_a_few_millionths() -> None:
    drift = fitted(1, -200.0, 60.0, "polled").drift()
    assert drift is not None
    assert abs(drift.ppm + 200.0) < 6.0
    assert drift.sd < 5.0


def test_drift_is_not_told_from_a_second() -> None:
    assert fitted(0, 50.0, 1.0, "streamed").drift() is None


def test_drift_memory_is_bounded_and_the_newest_counts() -> None:
    """After a quarter of an hour the clock changes pace; half an hour later the first pace is forgotten."""
    fit, rng = ClockFit(1000.0), np.random.default_rng(2)
    device = gateway = 0.0
    for step in range(27_000):
        device += 0.1
        gateway += 0.1 * (1 - (100e-6 if step < 9000 else -40e-6))
        fit.observe(round(device * 1000), round((gateway + rng.exponential(1e-3)) * 1e9))
    assert len(fit._bins) <= BINS
    assert fit.span_s < 1100.0
    drift = fit.drift()
    assert drift is not None
    assert drift.ppm == pytest.approx(-40.0, abs=2.0)


def test_lower_line_lies_below_every_point_and_touches_two() -> None:
    rng = np.random.default_rng(4)
    x = np.sort(rng.uniform(0, 10, 200))
    points = np.column_stack([x, 3.0 + 0.5 * x + rng.exponential(1.0, 200)])
    line = lower_line(points)
    above = points[:, 1] - line.offset_s - line.slope * points[:, 0]
    assert above.min() > -1e-12
    assert (above < 1e-9).sum() == 2
    assert line.slope == pytest.approx(0.5, abs=0.05)
