"""Lifted cells, merged summaries and sliding windows against sample-by-sample computation."""

from itertools import pairwise

import numpy as np
import pytest

from agent.numerics.model.observer import plain_gain
from agent.numerics.model.sensitivity import SensitivityFilter
from agent.numerics.model.statespace import discretise
from agent.numerics.window.cells import Summary, cell_operators, merge, propagate, run_cells, sliding, summarise_cells
from agent.numerics.window.sliding import Kept, slide
from tests.unit.numerics.model.test_statespace import widest_model
from tests.unit.numerics.rigs import FloatArray, filters, gain_of, noisy, sampled


def direct(f: SensitivityFilter, v: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Outputs (L p, 1+q), G (L p, nz) and the last state, a sample at a time."""
    o, G, power = [], [], np.eye(len(f.F))
    for sample in v:
        o.append((f.H @ z + f.J @ sample).reshape(f.p, 1 + f.q))
        z = f.F @ z + f.N @ sample
        by_state = (f.H @ power)[:, : f.n].reshape(f.p, 1 + f.q, f.n).copy()
        by_state[:, 0] *= -1
        G.append(by_state.reshape(f.p, -1))
        power = f.F @ power
    return np.vstack(o), np.vstack(G), z


def assert_same(summary: Summary, at: int, o: FloatArray, G: FloatArray) -> None:
    for ours, theirs in ((summary.gram[at], o.T @ o), (summary.moment[:, at], G.T @ o), (summary.GG, G.T @ G)):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-11 * np.abs(theirs).max())


@pytest.mark.parametrize("kind", ["zero", "kalman", "widest"])
def test_cells_summaries_merged_and_slid_equal_direct_computation(kind: str, rng: np.random.Generator) -> None:
    if kind == "widest":
        d = discretise(widest_model().continuous(widest_model().nominal), 0.01)
        f = filters(d, plain_gain(0.01 * rng.standard_normal((d.model.n, d.model.p)), np.ones(d.model.p)))
        v = rng.standard_normal((9 * 21, d.model.p + d.model.m))
    else:
        d = sampled()
        f = filters(d, gain_of(kind, d, 1e-6))
        v = noisy(rng, 9 * 21, 1e-6).v
    lengths, z = [12, 9], 0.01 * rng.standard_normal(len(f.F))
    operators = cell_operators(f, lengths)
    states = [z]
    pieces: dict[int, list[FloatArray]] = {12: [], 9: []}
    for start, length in ((21 * j + o, length) for j in range(9) for o, length in ((0, 12), (12, 9))):
        o, _, after = direct(f, v[start : start + length], states[-1])
        cells = v[start : start + length].reshape(1, -1)
        np.testing.assert_allclose(
            run_cells(operators[length], cells, states[-1][None])[0], o, atol=1e-9 * np.abs(o).max()
        )
        pieces[length].append(np.hstack([cells[0], states[-1]]))
        states.append(after)
    summaries = []
    for length in lengths:
        both = np.array(pieces[length])
        summaries.append(summarise_cells(operators[length], both[:, : -len(z)], both[:, -len(z) :]))
    hops = merge(*summaries)
    for count in (1, 2, 3, 5, 7, 9):
        slid = sliding(hops, count)
        assert len(slid) == 9 - count + 1
        for j in (0, len(slid) - 1):
            o, G, _ = direct(f, v[21 * j : 21 * (j + count)], states[2 * j])
            assert_same(slid, j, o, G)


def test_merge_any_grouping_gives_the_same(rng: np.random.Generator) -> None:
    d = sampled()
    f = filters(d, gain_of("kalman", d, 1e-6))
    cells = summarise_cells(cell_operators(f, [8])[8], noisy(rng, 24, 1e-6).v.reshape(3, -1), np.zeros((3, len(f.F))))
    a, b, c = (cells.part(slice(i, i + 1)) for i in range(3))
    left, right = merge(merge(a, b), c), merge(a, merge(b, c))
    for name in ("gram", "moment", "Pi", "GG"):
        x, y = getattr(left, name), getattr(right, name)
        np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12 * np.abs(y).max())


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 16, 17, 100])
def test_propagate_any_count_equals_a_plain_loop(count: int, rng: np.random.Generator) -> None:
    F, forced, z0 = 0.4 * rng.standard_normal((4, 4)), rng.standard_normal((count, 4)), rng.standard_normal(4)
    states, last = propagate(z0, F, forced)
    z = z0
    for k in range(count):
        np.testing.assert_allclose(states[k], z, rtol=1e-10, atol=1e-12)
        z = F @ z + forced[k]
    np.testing.assert_allclose(last, z, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 7, 16, 17, 31, 32, 100, 128, 150])
@pytest.mark.parametrize("cut", ["whole", "singly", "anyhow"])
def test_slide_any_length_and_any_cut_equals_doubling(count: int, cut: str, rng: np.random.Generator) -> None:
    total, nz = count + 70, 6
    Pi = 0.5 * rng.standard_normal((nz, nz)) / np.sqrt(nz)
    gram, moment = rng.standard_normal((total, 3, 3)), rng.standard_normal((nz, total, 3))
    hops = Summary(gram, moment, Pi, np.eye(nz))
    sizes = {"whole": [total], "singly": [1] * total, "anyhow": rng.integers(1, 90, total).tolist()}[cut]
    edges = np.minimum(np.cumsum([0, *sizes]), total)
    kept, pieces = Kept(), []
    for start, stop in pairwise(edges.tolist()):
        if stop > start:
            kept, windows = slide(kept, hops.part(slice(start, stop)), count)
            assert (0 if windows is None else len(windows)) == max(0, min(stop - start, stop - count + 1))
            pieces += [] if windows is None else [windows]
    expected = sliding(hops, count)
    np.testing.assert_allclose(np.concatenate([w.gram for w in pieces]), expected.gram, atol=1e-11)
    np.testing.assert_allclose(np.concatenate([w.moment for w in pieces], axis=1), expected.moment, atol=1e-11)
    np.testing.assert_allclose(pieces[-1].Pi, expected.Pi, atol=1e-14)
    np.testing.assert_allclose(pieces[-1].GG, expected.GG, atol=1e-11)
