"""The jackknife divided by its own expectation, and the scatter between windows."""

import numpy as np
import pytest

from agent.numerics.inference import tuning
from agent.numerics.inference.scatter import Scatter, block_grams, block_ratio

FREE = np.zeros((3, 3))


def blocks_of(rng: np.random.Generator, scale: float, common: float = 0.0) -> np.ndarray:
    """Grams of eight blocks of regressions with leverages that differ, residuals of sd `scale`."""
    out = []
    for j in range(8):
        X = (0.2 + j) * rng.standard_normal((60, 3))
        r = scale * rng.standard_normal(60) + common * X[:, 0] * rng.standard_normal()
        Z = np.column_stack([X, r])
        out.append(Z.T @ Z)
    return np.array(out)


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_scatter_ratio_is_the_factor_on_the_variance_whatever_the_leverage(scale: float) -> None:
    rng = np.random.default_rng(2)
    ratios = [block_ratio(blocks_of(rng, scale), FREE, np.zeros(3), slice(0, 3)) for _ in range(600)]
    sd = np.std(ratios, axis=0) / np.sqrt(len(ratios))
    assert np.all(np.abs(np.mean(ratios, axis=0) - scale**2) < 4 * sd)
    assert sd.max() < 0.05 * scale**2


def test_scatter_ratio_keeps_one_beside_a_prior() -> None:
    rng = np.random.default_rng(4)
    R = np.diag([0.0, 1e4, 0.0])
    ratios = []
    for _ in range(600):
        truth = rng.standard_normal(3) * np.array([0, 1e-2, 0])
        blocks = []
        for _ in range(8):
            X = rng.standard_normal((60, 3))
            Z = np.column_stack([X, X @ truth + rng.standard_normal(60)])
            blocks.append(Z.T @ Z)
        ratios.append(block_ratio(np.array(blocks), R, np.zeros(3), slice(0, 1))[0])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_scatter_common_to_a_block_is_seen() -> None:
    rng = np.random.default_rng(5)
    ratios = [block_ratio(blocks_of(rng, 1.0, 0.2), FREE, np.zeros(3), slice(0, 3)) for _ in range(100)]
    assert np.mean(ratios, axis=0)[0] > 3.0


def test_scatter_blocks_sum_to_the_gram_of_the_bins() -> None:
    rng = np.random.default_rng(6)
    samples = rng.standard_normal((160, 2, 4))
    bins = np.fft.rfft(samples, axis=0) / np.sqrt(160)
    grams = block_grams(bins, 160, 0.0)
    flat = samples.reshape(-1, 4)
    assert grams.sum(axis=0) == pytest.approx(flat.T @ flat)
    assert grams[0] == pytest.approx(flat[:40].T @ flat[:40])


def test_scatter_between_windows_ignores_drift_and_sees_jumps() -> None:
    rng = np.random.default_rng(7)
    drifting = wild = Scatter.prior(1)
    one = np.ones(1)
    for w in range(200):
        noise = rng.standard_normal(1)
        drifting = drifting.after(one, noise + 3.0 * w, one)
        wild = wild.after(one, 3.0 * noise, one)
    assert drifting.between[0] == pytest.approx(1.0, abs=0.5)
    assert wild.between[0] > 5.0


def test_scatter_never_makes_intervals_smaller_than_the_model() -> None:
    calm = Scatter.prior(2)
    for _ in range(30):
        calm = calm.after(np.full(2, 0.2), np.zeros(2), np.ones(2))
    assert np.all(calm.factor == 1.0)
    assert calm.dof <= tuning.SCATTER_MOST_DOF
