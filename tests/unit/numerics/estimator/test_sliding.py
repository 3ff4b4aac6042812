"""The estimator's stream: hop grid, cutting, segments, changes, noise learnt, silence, what is learnt and
adopted."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.numerics.estimator.outcome import Outcome
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.sliding import SlidingEstimator
from agent.numerics.model.uncertain import Rig
from agent.numerics.preprocessing.wire import Wire
from agent.numerics.window.filtering.hops import HopPlan
from agent.types import Reason, Status
from tests.unit.numerics.paper_rig import NOMINAL, PERIOD, rig
from tests.unit.numerics.rigs import Record, noisy, record, sampled

SIGMA = 1e-6
WORN = NOMINAL * [1.0, 0.7, 1.0, 1.0]


def settings(window: int, hop: int, sigma: float = SIGMA, longer: tuple[int, ...] = ()) -> EstimatorSettings:
    """The paper's rig, its constants exact, forces on both masses; sigma NaN: to be learnt."""
    model = replace(rig(), forces=("m2", "m1", "m2"))
    statistical = Rig(
        model,
        4,
        np.arange(1),
        np.ones(1, dtype=bool),
        np.array([1, 2]),
        (),
        PERIOD,
        "first",
        NOMINAL,
        0.02 * NOMINAL,
    )
    return EstimatorSettings(
        rig=statistical, plan=HopPlan(window, hop), longer=longer, sigma=np.full(2, sigma),
        sigma_spread=np.full(2, 0.3), floor=np.full(2, 3e-7), enough_sd=0.033 * NOMINAL,
        wanted_sd=0.01 * NOMINAL, wire=Wire.in_si(2),
    )  # fmt: skip


def estimator(
    window: int = 500, hop: int = 50, sigma: float = SIGMA, longer: tuple[int, ...] = ()
) -> SlidingEstimator:
    return SlidingEstimator(settings(window, hop, sigma, longer))


def run(ml: SlidingEstimator, samples: Record, cuts: list[int], start: int = 0) -> Outcome:
    edges = [0, *cuts, len(samples.y)]
    pieces = [ml.step(start + a, samples.y[a:b], samples.u[a:b]) for a, b in pairwise(edges) if b > a]
    return Outcome.joined([rows for rows in pieces if len(rows.index)], 4)


def full(rows: Outcome) -> NDArray[np.bool_]:
    return np.asarray((rows.status != Status.WARMING).all(axis=1))


def valid(rows: Outcome) -> NDArray[np.bool_]:
    return np.asarray((rows.status == Status.VALID).all(axis=1))


def broken(rows: Outcome) -> NDArray[np.bool_]:
    return np.asarray((rows.status == Status.INVALID).any(axis=1))


def worn_at(rng: np.random.Generator, change: int, samples: int) -> Record:
    """k2 falls by 30 % at sample `change`."""
    before = noisy(rng, change + 1, 0.0)
    after = record(
        sampled(WORN),
        np.vstack([before.u[-1:], 5 * rng.standard_normal((samples - change, 1))]),
        before.states[-1],
    )
    y = np.vstack([before.y[:-1], after.y[:-1]])
    return Record(
        y + SIGMA * rng.standard_normal(y.shape), np.vstack([before.u[:-1], after.u[:-1]]), before.states
    )


@pytest.mark.parametrize(("window", "hop"), [(500, 50), (510, 50), (499, 50), (50, 50), (400, 37)])
def test_sliding_hop_grid_counts_from_the_first_sample(
    window: int, hop: int, rng: np.random.Generator
) -> None:
    rows = run(estimator(window, hop), noisy(rng, 1200, SIGMA), [700])
    expected = [i for i in range(1200) if i % hop == (window - 1) % hop]
    assert rows.index.tolist() == expected
    assert full(rows).tolist() == [i >= window - 1 for i in expected]
    assert np.isnan(rows.theta[~full(rows)]).all()


@pytest.mark.parametrize("restart", [700, 723, 750])
def test_sliding_later_segment_keeps_the_grid_and_waits_for_a_whole_window(
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
    assert full(rows).tolist() == [i >= first for i in expected]


@pytest.mark.parametrize(("window", "longer"), [(500, ()), (500, (1000, 2000)), (250, (500, 1000))])
def test_sliding_any_cutting_of_the_stream_gives_the_same_rows(
    window: int, longer: tuple[int, ...], rng: np.random.Generator
) -> None:
    samples = worn_at(rng, 3210, 6000)
    cuttings = [[], list(range(1, 6000, 97)), np.unique(rng.integers(1, 6000, 40)).tolist(), [1, 2, 3, 4999]]
    first, *others = (run(estimator(window, 50, longer=longer), samples, cuts) for cuts in cuttings)
    for other in others:
        for name in ("index", "status", "reason", "window"):
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name), err_msg=name)
        believed = full(first) & ~broken(first)
        assert (np.abs(other.theta - first.theta)[believed] / first.sd[believed]).max() < 1e-6


def holed(samples: Record, rng: np.random.Generator) -> tuple[Record, NDArray[np.bool_], NDArray[np.bool_]]:
    """One reading in a hundred filled in by the one before, and a blow and a spike on the force that are
    suspect."""
    v = np.hstack([samples.y, samples.u])
    missing = rng.random(v.shape) < 0.01
    missing[0] = False
    for row, column in np.argwhere(missing).tolist():
        v[row, column] = v[row - 1, column]
    suspect = np.zeros(v.shape, dtype=bool)
    v[2001, 2] += 60.0
    suspect[[801, 1230, 2001], 2] = True
    return Record(v[:, :2], v[:, 2:], samples.states), missing, suspect & ~missing


@pytest.mark.parametrize(("longer", "window"), [((), 500), ((1000, 2000), 500), ((), 510)])
def test_sliding_any_cutting_of_a_stream_with_lost_and_suspect_readings_gives_the_same_rows(
    longer: tuple[int, ...], window: int, rng: np.random.Generator
) -> None:
    samples, missing, suspect = holed(noisy(rng, 4000, SIGMA), rng)
    runs = []
    for cuts in ([], list(range(1, 4000, 97)), np.unique(rng.integers(1, 4000, 40)).tolist()):
        ml, pieces = estimator(window, longer=longer), []
        for a, b in pairwise([0, *cuts, 4000]):
            pieces.append(ml.step(a, samples.y[a:b], samples.u[a:b], missing[a:b], suspect[a:b]))
        runs.append((ml.spikes, Outcome.joined([rows for rows in pieces if len(rows.index)], 4)))
    (spikes, first), *others = runs
    assert spikes == 1
    assert valid(first)[full(first)].mean() > 0.9
    assert np.abs((first.theta - NOMINAL) / first.sd)[full(first)].max() < 5
    for spikes_then, other in others:
        assert spikes_then == spikes
        for name in ("index", "status", "reason", "window"):
            np.testing.assert_array_equal(getattr(other, name), getattr(first, name), err_msg=name)
        assert (np.abs(other.theta - first.theta)[full(first)] / first.sd[full(first)]).max() < 1e-6


def test_sliding_two_runs_are_equal_to_the_last_bit(rng: np.random.Generator) -> None:
    samples = worn_at(rng, 1500, 3000)
    one, two = (run(estimator(), samples, [500, 1700]) for _ in range(2))
    for name in ("theta", "sd", "lower", "upper", "dof"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_sliding_step_is_changing_until_windows_are_free_of_it_and_then_right(
    rng: np.random.Generator,
) -> None:
    window, hop, change = 500, 50, 4020
    rows = run(estimator(window, hop), worn_at(rng, change, 8000), [])
    assert not broken(rows)[rows.index < change].any()
    # a window of which at least half is new may already be found clean: then it is right as well
    seen = (rows.index > change + 2 * hop) & (rows.index < change + window // 2)
    assert np.all(rows.reason[seen] == Reason.CHANGING)
    right = np.all(np.abs(rows.theta - WORN) < 5 * rows.sd, axis=1)
    assert (broken(rows) | right)[rows.index > change + 2 * hop].all()
    assert not broken(rows)[rows.index >= change + window + 3 * hop].any()
    assert abs(rows.theta[-1, 1] - WORN[1]) < 2.0


def test_sliding_noise_not_stated_is_learnt(rng: np.random.Generator) -> None:
    samples = noisy(rng, 12_000, 3e-6)
    stated, learnt = (run(estimator(1000, 50, sigma=s), samples, []) for s in (3e-6, np.nan))
    assert valid(learnt)[full(learnt)].mean() > 0.97
    late = valid(learnt) & valid(stated) & (learnt.index > 8000)
    np.testing.assert_allclose(learnt.sd[late], stated.sd[late], rtol=0.15)


def test_sliding_silence_is_neither_change_nor_knowledge(rng: np.random.Generator) -> None:
    ml = estimator()
    run(ml, noisy(rng, 2000, SIGMA), [])
    ml.start_segment()
    rows = run(
        ml, Record(SIGMA * rng.standard_normal((2000, 2)), np.zeros((2000, 1)), np.zeros(0)), [], start=3000
    )
    assert not broken(rows).any()
    assert not valid(rows).any()


def test_sliding_what_was_learnt_is_adopted(rng: np.random.Generator) -> None:
    samples = noisy(rng, 8000, 3e-6)
    ml = estimator(500, 50, sigma=np.nan)
    run(ml, samples, [])
    content = ml.knowledge()
    assert content is not None
    again = estimator(500, 50, sigma=np.nan)
    again.adopt(content)
    known = again.explainer.known
    assert known is not None
    assert ml.explainer.known is not None
    np.testing.assert_allclose(np.exp(known.noise.log_sigma), 3e-6, rtol=0.05)
    np.testing.assert_allclose(known.noise.log_sigma, ml.explainer.known.noise.log_sigma, rtol=1e-6)
    assert valid(run(again, noisy(rng, 600, 3e-6), [])).any()
    assert estimator().knowledge() is None
