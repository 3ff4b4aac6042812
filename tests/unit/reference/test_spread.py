"""Reference, spread between hours and days, and independent hours, of series whose truth is known."""

import numpy as np
import pytest

from agent.reference.spread import correlation_sum, huber, spread

HOUR = 3600.0


def walk(
    rng: np.random.Generator, hours: int, tau_h: float, sd: float, rows: int = 20
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of a stationary process with an exponential autocorrelation, and white noise of 0.5 on
    each."""
    step = 1.0 / rows
    keep = np.exp(-step / tau_h)
    x = np.empty(hours * rows)
    x[0] = sd * rng.standard_normal()
    pushed = sd * np.sqrt(1.0 - keep**2) * rng.standard_normal(len(x))
    for k in range(1, len(x)):
        x[k] = keep * x[k - 1] + pushed[k]
    return HOUR * step * np.arange(len(x)), 100.0 + x + 0.5 * rng.standard_normal(len(x))


def test_spread_is_that_of_the_slow_process_and_the_reference_is_known_as_well_as_said() -> None:
    off, spreads, times, independent = [], [], [], []
    for seed in range(40):
        t, value = walk(np.random.default_rng(seed), 200, 4.0, 1.0)
        found = spread(t, value, HOUR)
        off.append((found.reference - 100.0) / found.sd)
        spreads.append(found.spread_sd)
        times.append(found.correlation_s / HOUR)
        independent.append(found.n_effective)
        assert found.within_sd == pytest.approx(0.5, rel=0.15)
    assert np.median(spreads) == pytest.approx(1.0, rel=0.1)
    assert np.median(times) == pytest.approx(4.0, rel=0.35)
    assert np.median(independent) == pytest.approx(25.0, rel=0.35)
    # counted as 200 independent hours, the reference would be off by three of its deviations
    assert 0.7 < np.std(off) < 1.35


def test_few_bad_hours_move_neither_reference_nor_spread() -> None:
    t, value = walk(np.random.default_rng(1), 200, 0.2, 1.0)
    bad = value.copy()
    bad[1000:1200] -= 30.0
    bad[::97] += 500.0
    clean, found = spread(t, value, HOUR), spread(t, bad, HOUR)
    assert abs(found.reference - clean.reference) < 3 * clean.sd
    assert found.spread_sd < 1.6 * clean.spread_sd


def test_spread_between_days_counts_where_days_differ_and_hours_do_not() -> None:
    rng = np.random.default_rng(3)
    t = HOUR * np.arange(24 * 12) + 1.0
    value = 50.0 + np.repeat(2.0 * rng.standard_normal(12), 24) + 0.1 * rng.standard_normal(len(t))
    found = spread(t, value, HOUR)
    assert found.days_sd == pytest.approx(2.0, rel=0.5)
    assert found.spread_sd >= found.days_sd
    assert spread(t[:40], value[:40], HOUR).days_sd is None


def test_correlation_is_found_across_gaps() -> None:
    t, value = walk(np.random.default_rng(5), 2000, 4.0, 1.0, rows=1)
    number = np.arange(len(t))
    there = np.random.default_rng(6).random(len(t)) < 0.6
    whole, gapped = (correlation_sum(value[rows] - 100.0, number[rows]) for rows in (number >= 0, there))
    assert gapped == pytest.approx(whole, rel=0.2)


def test_values_that_never_move_have_no_spread() -> None:
    found = spread(np.arange(100.0), np.full(100, 7.0), 10.0)
    assert (found.reference, found.spread_sd, found.sd, found.within_sd) == (7.0, 0.0, 0.0, 0.0)
    assert huber(np.array([1.0, 1.0, 1.0, 9.0])) == 1.0
