"""The estimator's stream: hop grid, cutting, segments, policy of change, noise learnt, silence."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from agent.numerics.estimator.window_ml import WindowML
from agent.numerics.fitting.fit import Problem, fit_window
from agent.numerics.window.rows import Rows
from tests.unit.numerics.paper_rig import NOMINAL, rig
from tests.unit.numerics.rigs import FixedGains, Record, gain_of, noisy, record, sampled, settings

SIGMA = 1e-6
WORN = NOMINAL * [1.0, 0.7, 1.0, 1.0]


def run(ml: WindowML, samples: Record, cuts: list[int], start: int = 0) -> Rows:
    edges = [0, *cuts, len(samples.y)]
    pieces = [ml.step(start + a, samples.y[a:b], samples.u[a:b]) for a, b in pairwise(edges) if b > a]
    return Rows.joined([rows for rows in pieces if len(rows.index)], 4)


def estimator(window: int = 500, hop: int = 50, **options: object) -> WindowML:
    return WindowML(rig(), settings(window, hop, **options))  # type: ignore[arg-type]


def several(window: int, longer: tuple[int, ...]) -> WindowML:
    plain = settings(window, 50, 5e-6)
    return WindowML(rig(), replace(plain, longer=longer, wanted_sd=0.01 * NOMINAL))


def worn_at(rng: np.random.Generator, change: int, samples: int, sigma: float = SIGMA) -> Record:
    """k2 falls by 30 % at sample `change`."""
    before = noisy(rng, change + 1, 0.0)
    after = record(
        sampled(WORN), np.vstack([before.u[-1:], 5 * rng.standard_normal((samples - change, 1))]), before.states[-1]
    )
    y = np.vstack([before.y[:-1], after.y[:-1]])
    return Record(y + sigma * rng.standard_normal(y.shape), np.vstack([before.u[:-1], after.u[:-1]]), before.states)


@pytest.mark.parametrize(("window", "hop"), [(500, 50), (510, 50), (499, 50), (30, 50), (50, 50), (501, 1), (400, 37)])
def test_window_ml_hop_grid_counts_from_the_first_sample(window: int, hop: int, rng: np.random.Generator) -> None:
    rows = run(estimator(window, hop), noisy(rng, 1200, SIGMA), [700])
    expected = [i for i in range(1200) if i % hop == (window - 1) % hop]
    assert rows.index.tolist() == expected
    assert rows.full.tolist() == [i >= window - 1 for i in expected]
    assert np.isnan(rows.theta[~rows.full]).all()


@pytest.mark.parametrize("restart", [0, 700, 723, 750])
def test_window_ml_later_segment_keeps_the_grid_and_waits_for_a_whole_window(
    restart: int, rng: np.random.Generator
) -> None:
    ml = estimator(240, 50)
    run(ml, noisy(rng, 600, SIGMA), [])
    ml.start_segment()
    rows = run(ml, noisy(rng, 900, SIGMA), [20, 40, 300], start=restart)
    expected = [i for i in range(restart, restart + 900) if i % 50 == 239 % 50]
    assert rows.index.tolist() == expected
    # a window starts on the grid of hops, so the first after a gap starts at the next multiple of the hop
    first = -(-restart // 50) * 50 + 239
    assert rows.full.tolist() == [i >= first for i in expected]


@pytest.mark.parametrize(("kind", "window", "tolerance"), [
    ("automatic", 1010, 1e-9), ("zero", 1010, 1e-9), ("kalman", 1010, 1e-9), ("poles", 1010, 1e-9),
    # a window of a fifteenth of the slowest period, without correction: the Gram form itself resolves no more
    ("kalman", 250, 1e-8), ("automatic", 250, 1e-4),
])  # fmt: skip
def test_window_ml_any_cutting_of_the_stream_gives_the_same_rows(
    kind: str, window: int, tolerance: float, rng: np.random.Generator
) -> None:
    samples = worn_at(rng, 3210, 6000)
    gains = None if kind == "automatic" else FixedGains(kind)
    cuttings = [[], list(range(1, 6000, 97)), np.unique(rng.integers(1, 6000, 40)).tolist(), [1, 2, 3, 4999]]
    first, *others = (run(estimator(window, 50, gains=gains), samples, cuts) for cuts in cuttings)
    believed = first.full & ~first.changing & ~first.mismatch
    assert believed.sum() > 10
    for other in others:
        for name in ("index", "full", "changing", "mismatch"):
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name), err_msg=name)
        apart = np.abs(other.theta - first.theta)[first.full] / first.sd[first.full]
        assert apart[believed[first.full]].max() < tolerance
        assert apart.max() < 100 * tolerance
        np.testing.assert_allclose(other.sd, first.sd, rtol=max(1e-9, tolerance))


@pytest.mark.parametrize("longer", [(1000, 2000), (5000,)])
def test_window_ml_any_cutting_gives_the_same_rows_of_several_windows(
    longer: tuple[int, ...], rng: np.random.Generator
) -> None:
    samples = worn_at(rng, 9210, 16_000, sigma=5e-6)
    cuttings = [[], list(range(1, 16_000, 197)), np.unique(rng.integers(1, 16_000, 40)).tolist()]
    first, *others = (run(several(500, longer), samples, cuts) for cuts in cuttings)
    assert first.each_fits[:, 1:].any(axis=0).all()
    for other in others:
        for name in ("index", "full", "changing", "mismatch", "window", "each_fits"):
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name), err_msg=name)
        told = first.each_fits & ~(first.changing | first.mismatch)[:, None]
        apart = np.abs(other.each_theta - first.each_theta)[told] / first.each_sd[told]
        assert apart.max() < 1e-3
        np.testing.assert_allclose(other.each_sd[told], first.each_sd[told], rtol=1e-3)


def test_window_ml_step_is_found_with_longer_windows_as_fast_as_with_the_short_one(rng: np.random.Generator) -> None:
    samples = worn_at(rng, 12_210, 20_000, sigma=5e-6)
    alone, among = (run(ml, samples, []) for ml in (several(500, ()), several(500, (1000, 2000, 5000))))
    begins, ends = (
        [rows.index[rows.changing & (rows.index > 12_000)][which] for rows in (alone, among)] for which in (0, -1)
    )
    assert begins[1] <= begins[0]
    assert ends[1] <= ends[0] + 50


def test_window_ml_window_too_long_for_one_step_from_theta_r_is_none_to_choose_from(rng: np.random.Generator) -> None:
    samples = noisy(rng, 10_000, 5e-6, 1.08 * NOMINAL)
    rows = run(several(250, (5000,)), samples, [4999])
    whole = rows.index >= 4999
    off = np.abs(rows.each_theta[whole, 1] - 1.08 * NOMINAL) / rows.each_sd[whole, 1]
    assert rows.each_fits[whole, 1].mean() > 0.8
    assert off[rows.each_fits[whole, 1]].max() < 4.5


def test_window_ml_two_runs_are_equal_to_the_last_bit(rng: np.random.Generator) -> None:
    samples = worn_at(rng, 1500, 3000)
    one, two = (run(estimator(), samples, [500, 1700]) for _ in range(2))
    for name in ("theta", "sd", "ratio", "dof"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_window_ml_step_change_is_changing_until_windows_are_free_of_it_and_then_right(
    rng: np.random.Generator,
) -> None:
    window, hop, change = 500, 50, 4020
    rows = run(estimator(window, hop), worn_at(rng, change, 8000), [])
    changing = rows.changing | rows.mismatch
    assert not changing[rows.index < change].any()
    # a window of which at least half is new may already be found clean: then it is right as well
    seen = (rows.index > change + 2 * hop) & (rows.index < change + window // 2)
    assert rows.changing[seen].all()
    right = np.all(np.abs(rows.theta - WORN) < 5 * rows.sd, axis=1)
    assert (changing | right)[rows.index > change + 2 * hop].all()
    # the change is seen a few hops after it began, and a window that begins then is free of it for certain
    assert not changing[rows.index >= change + window + 3 * hop].any()
    assert abs(rows.theta[-1, 1] - WORN[1]) < 2.0


def test_window_ml_lasting_mismatch_is_said_after_a_window(rng: np.random.Generator) -> None:
    """A third of the force is not measured any more: no spring explains that."""
    samples, change, window = noisy(rng, 6000, SIGMA), 3000, 500
    samples.u[change:] += 2.0 * rng.standard_normal((3000, 1))
    rows = run(estimator(window, 50, gains=FixedGains("zero")), samples, [])
    late = rows.index >= change + 2 * window
    assert rows.mismatch[late].mean() > 0.9
    assert not rows.changing[late & rows.mismatch].any()
    assert not (rows.changing | rows.mismatch)[rows.index < change].any()


def test_window_ml_noise_not_stated_is_learnt(rng: np.random.Generator) -> None:
    samples = noisy(rng, 6000, 3e-6)
    told, learnt = (run(estimator(1000, 50, sigma=s), samples, []) for s in (3e-6, np.nan))
    valid = learnt.full & ~learnt.changing & ~learnt.mismatch
    assert valid[learnt.full].mean() > 0.99
    np.testing.assert_allclose(learnt.sd[valid], told.sd[valid], rtol=0.1)
    # at the end the two are linearised about points that differ within their uncertainty
    np.testing.assert_allclose(learnt.theta[-1] / told.sd[-1], told.theta[-1] / told.sd[-1], atol=0.3)


def test_window_ml_silence_is_neither_change_nor_knowledge(rng: np.random.Generator) -> None:
    ml = estimator()
    run(ml, noisy(rng, 2000, SIGMA), [])
    ml.start_segment()
    rows = run(ml, Record(SIGMA * rng.standard_normal((2000, 2)), np.zeros((2000, 1)), np.zeros(0)), [], start=3000)
    enough = ml.settings.enough_sd
    assert not (rows.changing | rows.mismatch).any()
    assert np.all(~(rows.sd[rows.full] < enough))
    nothing = run(estimator(), Record(np.zeros((2000, 2)), np.zeros((2000, 1)), np.zeros(0)), [])
    assert not (nothing.changing | nothing.mismatch).any()
    assert np.all(~(nothing.sd[nothing.full] < enough))


def test_window_ml_estimates_depend_on_the_window_alone(rng: np.random.Generator) -> None:
    """Two streams with different pasts and the same last window; held fixed: theta_r (nothing calls for a move)."""
    window, last = 1000, noisy(rng, 1000, SIGMA)
    results = []
    for loudness in (1.0, 3.0):
        past = noisy(rng, 2000, SIGMA)
        ml = estimator(window, 50)
        ml.point.theta[:] = 1.0001 * NOMINAL
        ml.point.settled = ml._anchored = ml._searched = True
        ml.point.rebuild()
        y, u = np.vstack([loudness * past.y, last.y]), np.vstack([loudness * past.u, last.u])
        ml._upkeep.coloured_at = 0
        results.append(run(ml, Record(y, u, last.states), [1999]))
        assert np.array_equal(ml.point.theta, 1.0001 * NOMINAL)
    a, b = results
    assert np.nanmax(np.abs(a.theta[-10] - b.theta[-10]) / a.sd[-10]) > 1e-3
    np.testing.assert_allclose(a.theta[-1] / a.sd[-1], b.theta[-1] / a.sd[-1], atol=1e-9)


def test_window_ml_long_window_equals_the_fit_on_its_samples(rng: np.random.Generator) -> None:
    """Beyond 4096 samples the fit iterates on summaries: the estimate is the same maximum."""
    samples = noisy(rng, 9000, SIGMA, 0.8 * NOMINAL)
    long = run(estimator(9000, 50), samples, [])
    assert long.full[-1]
    assert np.all(np.abs(long.theta[-1] - 0.8 * NOMINAL) < 4 * long.sd[-1])
    problem = Problem(sampled, samples.v, NOMINAL, 0.02 * NOMINAL)
    fit = fit_window(problem, NOMINAL * 0.8, np.zeros(4), [lambda d: gain_of("zero", d, SIGMA)])
    np.testing.assert_allclose(long.theta[-1] / long.sd[-1], fit.theta / long.sd[-1], atol=2e-2)
