"""Limits proposed from a healthy spread: how often they are crossed and what they find, played row by row."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.signal import lfilter

from agent.blocks.level_alarms import LevelAlarms
from agent.reference.limits import Healthy, Limit, false_per_year, proposed
from agent.units import YEAR_S
from tests.unit.blocks.test_level_alarms import batch

HEALTHY = Healthy(1.0, 3600.0, 200.0, 0.5, 0.5, 4.0, 2.0)
DAY_S = 86_400.0


@dataclass(frozen=True)
class Rule:
    limit: float
    on_delay_s: float
    parameter: str = "k1"
    limit_percent: float | None = None
    side: str = "both"
    confidence: float = 0.95
    deadband: float | None = None
    off_delay_s: float | None = None
    priority: str = "high"
    advice: str | None = None


def rule(found: Limit) -> Rule:
    return Rule(found.limit, found.on_delay_s)


def change(rng: np.random.Generator, healthy: Healthy, seconds: float) -> np.ndarray:
    """Rows of a healthy machine about its reference: an exponential autocorrelation, and windows that
    overlap."""
    n = round(seconds / healthy.hop_s)
    keep = np.exp(-healthy.hop_s / healthy.correlation_s)
    pushed = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    pushed[0] = rng.standard_normal()
    slow = healthy.spread_sd * lfilter([1.0], [1.0, -keep], pushed)
    overlap = round(healthy.window_s / healthy.hop_s)
    fine = rng.standard_normal(n + overlap)
    noise = np.convolve(fine, np.full(overlap, overlap**-0.5), mode="valid")[:n]
    return slow + healthy.scatter_sd * noise


def raised(found: Limit, healthy: Healthy, values: np.ndarray) -> np.ndarray:
    """Seconds at which an alarm with a proposed limit is raised."""
    alarms = LevelAlarms("press", [rule(found)], 1.0 / healthy.hop_s)
    n = len(values)
    rows = batch(
        25.0 + values, sd=healthy.row_sd, index=np.arange(n), window_s=np.full((n, 1), healthy.window_s)
    )
    steps = alarms.step(rows)
    seconds = healthy.hop_s * np.searchsorted(
        rows.t_ns, [step.t_ns for step in steps if step.cause == "raise"]
    )
    return np.asarray(seconds)


@pytest.mark.parametrize(
    "healthy", [HEALTHY, replace(HEALTHY, spread_sd=0.05), replace(HEALTHY, scatter_sd=0.01)]
)
def test_proposed_limit_is_not_crossed_in_thirty_days_of_other_seeds(healthy: Healthy) -> None:
    found = proposed(healthy, per_year=1.0)
    assert found.false_per_year <= 1.0 + 1e-9
    assert len(raised(found, healthy, change(np.random.default_rng(8), healthy, 30 * DAY_S))) <= 1


def test_false_alarms_come_no_more_often_than_said_and_not_much_more_seldom() -> None:
    healthy = Healthy(1.0, 3600.0, 1e6, 0.5, 0.5, 40.0, 20.0)
    found = proposed(healthy, per_year=1000.0)
    days = 200.0
    count = len(raised(found, healthy, change(np.random.default_rng(1), healthy, days * DAY_S)))
    expected = 1000.0 * days * DAY_S / YEAR_S
    assert 0.05 * expected < count <= expected


def test_change_that_is_said_to_be_found_is_found_in_time() -> None:
    found = proposed(HEALTHY, 1.0)
    late = 0
    for seed in range(60):
        values = change(np.random.default_rng([seed, 1]), HEALTHY, 1200.0)
        at = 600.0
        values[round(at / HEALTHY.hop_s) :] += found.finds
        alarms = raised(found, HEALTHY, values)
        late += not any(at < t <= at + found.finds_within_s for t in alarms)
    assert late <= 12


def test_limit_grows_with_the_spread_with_ignorance_and_with_what_is_asked() -> None:
    plain = proposed(HEALTHY, 1.0)
    assert proposed(replace(HEALTHY, spread_sd=2.0), 1.0).limit > plain.limit
    assert proposed(replace(HEALTHY, n_effective=5.0), 1.0).limit > 1.3 * plain.limit
    assert proposed(HEALTHY, 0.01).limit > plain.limit
    assert false_per_year(HEALTHY, plain.limit, plain.on_delay_s) == pytest.approx(plain.false_per_year)
    assert false_per_year(HEALTHY, 0.5 * plain.limit, plain.on_delay_s) > 50


def test_machine_without_spread_and_noise_gets_a_limit_above_nothing() -> None:
    still = proposed(Healthy(0.0, 10.0, 24.0, 0.0, 0.0, 1.0, 0.5), 1.0)
    assert still.limit > 0
    assert still.false_per_year == 0.0
