"""Rows that share no samples, and changes of few of them: never a number that means nothing."""

import numpy as np
import pytest

from agent.prognosis.change import Change, change
from agent.prognosis.history import History, disjoint
from agent.units import DAY_NS

SECOND = 1_000_000_000


def asked(t_ns: np.ndarray, value: np.ndarray, sd: np.ndarray, span_s: np.ndarray) -> Change | None:
    rows = disjoint(t_ns, span_s)
    return change(History((t_ns[rows] - t_ns[-1]) / DAY_NS, value[rows], sd[rows]))


@pytest.mark.parametrize("n", range(3))
def test_change_of_fewer_than_three_rows_is_none(n: int) -> None:
    assert change(History(np.arange(float(n)), np.full(n, 25.0), np.full(n, 0.5))) is None


def test_change_of_rows_at_one_instant_is_none() -> None:
    assert change(History(np.full(9, 1.0), np.arange(9.0), np.ones(9))) is None


@pytest.mark.parametrize("n", [3, 4, 5])
def test_change_of_few_rows_is_a_line_without_curvature(n: int) -> None:
    found = change(History(np.arange(float(n)), 30.0 - 0.5 * np.arange(n), np.full(n, 0.1)))
    assert found is not None
    assert found.slope == pytest.approx(-0.5)
    assert found.newest == found.slope
    assert found.slope_lower < -0.5 < found.slope_upper
    assert not np.isfinite(found.curvature_sd)
    assert found.level == pytest.approx(30.0 - 0.5 * (n - 1))


@pytest.mark.parametrize(("n", "sd"), [(3, 1.0), (4, 0.0), (5, 1.0)])
def test_change_of_few_rows_of_noise_is_no_trend(rng: np.random.Generator, n: int, sd: float) -> None:
    noise = (History(np.arange(float(n)), 25.0 + rng.standard_normal(n), np.full(n, sd)) for _ in range(100))
    found = [change(history) for history in noise]
    assert sum(one is not None and one.trend for one in found) <= 5
    assert sum(one is not None and one.slope_lower < 0.0 < one.slope_upper for one in found) >= 88


def test_change_knows_how_probable_a_rate_is(rng: np.random.Generator) -> None:
    found = change(
        History(np.arange(60.0), 25.0 - 0.2 * np.arange(60) + rng.standard_normal(60), np.ones(60))
    )
    assert found is not None
    below = [1.0 - found.rates.above(-rate) for rate in (0.02, 0.2, 2.0)]
    assert below[0] > 0.97
    assert 0.03 < below[1] < 0.97
    assert below[2] < 0.01


def test_disjoint_newest_row_is_kept_and_no_two_spans_meet() -> None:
    t = np.arange(1, 101) * SECOND // 20
    kept = disjoint(t, np.full(100, 0.25))
    assert kept[-1] == 99
    assert set(np.diff(t[kept])) == {SECOND // 4}


def test_disjoint_mixed_spans_keep_what_fits() -> None:
    t = np.array([3600, 7200, 7260, 7320, 7321, 7322]) * SECOND
    assert disjoint(t, np.array([3600, 3600, 60, 60, 1.0, 1.0])).tolist() == [0, 1, 2, 3, 4, 5]
    assert disjoint(t, np.array([3600, 3600, 60, 60, 1.0, 50.0])).tolist() == [0, 1, 2, 5]


def test_disjoint_rows_at_one_instant_end() -> None:
    assert disjoint(np.zeros(5, np.int64), np.zeros(5)).tolist() == [0, 1, 2, 3, 4]
    assert disjoint(np.zeros(5, np.int64), np.ones(5)).tolist() == [4]


def overlapping(rng: np.random.Generator, n: int, overlap: int) -> np.ndarray:
    """Estimates of standard deviation 1 whose windows share (overlap - 1)/overlap of their samples."""
    steps = rng.normal(0, 1, n + overlap)
    return (np.cumsum(steps)[overlap:] - np.cumsum(steps)[:-overlap]) / np.sqrt(overlap)


@pytest.mark.parametrize(("n", "overlap"), [(60, 5), (600, 5), (3000, 20)])
def test_change_of_overlapping_windows_says_no_trend(rng: np.random.Generator, n: int, overlap: int) -> None:
    t, span = (np.arange(n) * 0.01 * DAY_NS).astype(np.int64), np.full(n, 0.01 * overlap * 86400)
    found = [asked(t, overlapping(rng, n, overlap), np.ones(n), span) for _ in range(60)]
    assert sum(one is not None and one.trend for one in found) <= 8


def test_change_of_a_slow_disturbance_is_no_trend(rng: np.random.Generator) -> None:
    """A daily cycle three times the sd, seen over 2 to 9 days at any phase, on top of white noise."""
    falsely = 0
    for _ in range(60):
        t = np.linspace(0, rng.uniform(2, 9), 2000)
        y = rng.normal(0, 1, 2000) + 3 * np.sin(2 * np.pi * (t + rng.uniform()))
        found = change(History(t, y, np.ones(2000)))
        falsely += found is not None and found.trend
    assert falsely <= 8


def test_change_never_gives_what_is_not_finite(rng: np.random.Generator) -> None:
    for n in range(3, 50):
        t = np.sort(rng.uniform(0, 1e-9, n))
        found = change(History(t, np.full(n, 1e-7), np.full(n, 1e-9)))
        assert found is not None
        assert np.isfinite(
            [found.level, found.level_sd, found.slope, found.slope_lower, found.slope_upper]
        ).all()
