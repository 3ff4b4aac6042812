"""A pass over the intensities: the Gram follows each that moves, and costs what its columns do."""

import tracemalloc
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.numerics.inference.noise.intensities import Scan, first_nodes
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit
from agent.types import FloatArray
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, linearised, record

RIG = ChainRig()
SIGMA = np.array([1e-4, 2e-4])
SAMPLES = 600
NOISE = DenseNoise(SIGMA, np.array([0.0, 0.05]))


def scan_of(lost_rows: int) -> Scan:
    """Return a scan of a window with unknown forces in which so many rows of outputs are lost."""
    rng = np.random.default_rng(7)
    learner = learner_of(RIG, SAMPLES)
    window, *_ = record(RIG, rng, NOISE, SAMPLES)
    rows = np.sort(rng.choice(SAMPLES, lost_rows, replace=False))
    lost = np.array([(row, channel) for row in rows for channel in (0, 1)], dtype=np.int64).reshape(-1, 2)
    window = replace(window, lost=lost, lost_sd=np.full(len(lost), np.inf))
    known = knowledge(learner, NOISE)
    at = linearised(learner, known, window)
    nodes: FloatArray = first_nodes(at.cells, known.noise.log_sigma)
    noise = replace(known.noise, nodes=nodes, intensity=nodes[:, 4].copy())
    wide = learner.lineariser.ridge(at.regression.layout, window, 1e-12 * np.eye(6), np.zeros(6))
    fit = NoiseFit(noise, at.cells, at.regression, learner.sources, wide)
    fit.refresh()
    return Scan(fit, np.zeros_like(nodes), nodes, every=True, pred=None)


@pytest.mark.parametrize("lost_rows", [0, 20])
def test_gram_follows_each_intensity_as_if_made_anew(lost_rows: int) -> None:
    scan = scan_of(lost_rows)
    fit = scan.fit
    moved = 0
    for a in range(len(fit.sources)):
        before = fit.intensity[a]
        scan.axis(a)
        moved += fit.intensity[a] != before
        followed, inverse = fit.G.copy(), fit.Si.copy()
        fit.refresh()
        size = np.sqrt(np.diag(fit.G))
        assert np.abs((followed - fit.G) / np.outer(size, size)).max() < 1e-9
        np.testing.assert_allclose(inverse, fit.Si, rtol=1e-6, atol=1e-9 * np.abs(fit.Si).max())
    assert moved


def test_scan_of_a_window_with_lost_readings_holds_no_table_of_all_pairs_of_columns() -> None:
    scan = scan_of(60)
    fit = scan.fit
    columns, cells = fit.layout.base + 1, fit.cells.kept
    nodes = scan.nodes.shape[1]
    tracemalloc.start()
    scan.axis(0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert columns > 120
    # a few Grams a node, and a few copies of the columns; pairs of columns in each cell would be 50 MB more
    assert peak < 8 * (8 * nodes * columns**2 + 16 * cells * columns)


def scan_that_leaves(left: float) -> Scan:
    """A window of one bin and one column, of which a source as strong as the second node leaves so much."""
    shown = 1e26
    cells: Any = SimpleNamespace(
        kept=1, weight=np.ones(1), spectra=np.ones((1, 1)), D=np.ones((1, 1, 1), dtype=complex)
    )
    fit: Any = SimpleNamespace(
        cells=cells, layout=SimpleNamespace(base=1, ends=slice(0, 0)), intensity=np.zeros(1),
        Si=np.ones((1, 1, 1), dtype=complex), X=np.array([[[np.sqrt(2 * shown), 1.0]]], dtype=complex),
        high=SimpleNamespace(R=np.zeros((0, 1, 1))), G=np.diag([shown * (1 + left), 1e3]),
        prior=np.zeros((2, 2)), ends=SimpleNamespace(precision=lambda each: np.ones((len(each), 0))),
    )  # fmt: skip
    nodes = np.array([[0.0, 1.0]])
    return Scan(fit, np.zeros((1, 2)), nodes, every=True, pred=None)


def test_node_that_leaves_less_than_nothing_of_a_column_has_no_digits() -> None:
    """Of a column's power 1e26 the change takes all but a part in 1e12, or as much more by rounding."""
    with np.errstate(all="raise"):
        gain, node = scan_that_leaves(1e-12).best(0)
        assert node in {0.0, 1.0}
        assert np.isfinite(gain)
        assert scan_that_leaves(-1e-12).best(0) == (0.0, 0.0)
