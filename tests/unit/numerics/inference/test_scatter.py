"""The jackknife divided by its own expectation, and the scatter between windows."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import gammaln

from agent.numerics.inference import learner as learning
from agent.numerics.inference import tuning
from agent.numerics.inference.scatter import (
    Estimate,
    Scatter,
    block_grams,
    block_ratio,
    by_repeats,
    expected,
)
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, linearised, record

FREE, NO_CONSTANTS = np.zeros((3, 3)), np.zeros((0, 0))


def blocks_of(rng: np.random.Generator, scale: float, common: float = 0.0) -> np.ndarray:
    """Grams of eight blocks of regressions with leverages that differ, residuals of sd `scale`."""
    X = np.array([(0.2 + j) * rng.standard_normal((60, 3)) for j in range(8)])
    noise = scale * rng.standard_normal((8, 60)) + common * X[:, :, 0] * rng.standard_normal((8, 1))
    return grams_of(X, noise, FREE)


def grams_of(X: np.ndarray, y: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Grams of blocks X (J, n, k) and of what their fit, with the prior R, leaves of y (J, n)."""
    flat = X.reshape(-1, X.shape[-1])
    fit = np.linalg.solve(flat.T @ flat + R, flat.T @ y.ravel())
    Z = np.concatenate([X, (y - X @ fit)[..., None]], axis=2)
    return Z.transpose(0, 2, 1) @ Z


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_scatter_ratio_is_the_factor_on_the_variance_whatever_the_leverage(scale: float) -> None:
    rng = np.random.default_rng(2)
    ratios = [block_ratio(blocks_of(rng, scale), FREE, NO_CONSTANTS, slice(0, 3)) for _ in range(600)]
    sd = np.std(ratios, axis=0) / np.sqrt(len(ratios))
    assert np.all(np.abs(np.mean(ratios, axis=0) - scale**2) < 4 * sd)
    assert sd.max() < 0.05 * scale**2


def test_scatter_ratio_keeps_one_beside_a_prior() -> None:
    rng = np.random.default_rng(4)
    R = np.diag([0.0, 1e4, 0.0])
    ratios = []
    for _ in range(600):
        truth = rng.standard_normal(3) * np.array([0, 1e-2, 0])
        X = rng.standard_normal((8, 60, 3))
        blocks = grams_of(X, X @ truth + rng.standard_normal((8, 60)), R)
        ratios.append(block_ratio(blocks, R, NO_CONSTANTS, slice(0, 1))[0])
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_scatter_ratio_keeps_one_beside_constants_that_take_their_share_of_the_readings() -> None:
    rng = np.random.default_rng(7)
    sheets, columns = np.eye(4), slice(0, 3)
    ratios = []
    for _ in range(1500):
        X, E = rng.standard_normal((8, 3, 3)), rng.standard_normal((8, 3, 4))
        y = E @ rng.standard_normal(4) + rng.standard_normal((8, 3))
        R = np.diag([0.0] * 3 + [1.0] * 4)
        left = grams_of(np.concatenate([X, E], axis=2), y, R)[:, :, -1]  # scores of all columns
        flat, other = X.reshape(-1, 3), E.reshape(-1, 4)
        beyond = E - X @ np.linalg.solve(flat.T @ flat, flat.T @ other)
        C = np.linalg.inv(np.einsum("jnc,jnd->cd", beyond, beyond) + sheets)
        Z = np.concatenate([X, beyond], axis=2)
        blocks = np.zeros((8, 8, 8))
        blocks[:, :7, :7] = Z.transpose(0, 2, 1) @ Z
        blocks[:, columns, -1] = left[:, columns]
        ratios.append(block_ratio(blocks, np.zeros((3, 3)), C, columns))
    sd = np.std(ratios, axis=0) / np.sqrt(len(ratios))
    assert np.all(np.abs(np.mean(ratios, axis=0) - 1.0) < 4 * sd)
    assert sd.max() < 0.04


def test_scatter_common_to_a_block_is_seen() -> None:
    rng = np.random.default_rng(5)
    ratios = [block_ratio(blocks_of(rng, 1.0, 0.2), FREE, NO_CONSTANTS, slice(0, 3)) for _ in range(100)]
    assert np.mean(ratios, axis=0)[0] > 3.0


def test_scatter_blocks_sum_to_the_gram_of_the_bins() -> None:
    rng = np.random.default_rng(6)
    samples = rng.standard_normal((160, 2, 4))
    bins = np.fft.rfft(samples, axis=0) / np.sqrt(160)
    grams = block_grams(bins, 160)
    flat = samples.reshape(-1, 4)
    assert grams.sum(axis=0) == pytest.approx(flat.T @ flat)
    assert grams[0] == pytest.approx(flat[:40].T @ flat[:40])


def estimate(theta: float, eta: float = 0.0, sd: float = 1.0) -> Estimate:
    """One parameter that grows by 2 with each unit of one constant."""
    return Estimate(np.array([theta + 2 * eta]), np.array([[sd**2]]), np.array([[2.0]]), np.array([eta]))


def test_scatter_between_windows_ignores_drift_and_sees_jumps() -> None:
    rng = np.random.default_rng(7)
    drifting = wild = Scatter.prior(1)
    one = np.ones(1)
    for w in range(200):
        noise = float(rng.standard_normal())
        drifting = drifting.after(one, estimate(noise + 3.0 * w))
        wild = wild.after(one, estimate(3.0 * noise))
    assert drifting.between[0] == pytest.approx(1.0, abs=0.5)
    assert wild.between[0] > 5.0


def test_scatter_never_makes_intervals_smaller_than_the_model() -> None:
    calm = Scatter.prior(2)
    for _ in range(30):
        calm = calm.after(np.full(2, 0.2), Estimate(np.zeros(2), np.eye(2), np.zeros((2, 1)), np.zeros(1)))
    assert np.all(calm.factor == 1.0)
    assert calm.dof <= tuning.SCATTER_MOST_DOF


def test_scatter_of_few_windows_is_weighed_against_the_model_and_of_many_believed() -> None:
    pooled = np.array([0.5, 1.0, 1.5, 4.0])
    few, many = expected(pooled, 2.0), expected(pooled, 100.0)
    assert few[:2] == pytest.approx(1.0)
    assert many[:2] == pytest.approx(1.0)
    assert 1.0 < few[2] < 1.3
    assert few[3] < 3.7
    assert many[3] > 3.99


def test_scatter_expected_is_that_of_a_mixture_of_both_explanations() -> None:
    """Against the marginal likelihoods by quadrature: c = 1, or 1 / c from a gamma distribution of mean 1."""
    prior, seen, pooled = tuning.SCATTER_PRIOR_DOF, 6.0, 1.8
    power, n = 0.5 * ((seen + prior) * pooled - prior), 0.5 * seen
    t = np.linspace(1e-4, 12.0, 400_001)
    a = 0.5 * prior
    density = t ** (a - 1) * np.exp(-a * t) * a**a / np.exp(gammaln(a))
    slab = np.trapezoid(density * t ** (0.5 * n) * np.exp(-0.5 * power * t), t)
    odds = slab / np.exp(-0.5 * power)
    assert expected(np.array([pooled]), seen)[0] == pytest.approx(
        1 + odds / (1 + odds) * (pooled - 1), rel=1e-6
    )


def test_scatter_compares_windows_at_the_same_constants(rng: np.random.Generator) -> None:
    one, still = np.ones(1), Scatter.prior(1)
    for eta in rng.uniform(-5.0, 5.0, 100).tolist():
        still = still.after(one, estimate(float(rng.standard_normal()), eta))
    assert still.between[0] == pytest.approx(1.0, abs=0.5)


def test_scatter_says_what_the_windows_before_said_until_one_differs() -> None:
    one, none = np.ones(1), Scatter.prior(1)
    assert none.steady(estimate(1.0)) is None
    known = none.after(one, estimate(1.0)).after(one, estimate(2.0))
    said = known.steady(estimate(1.6, eta=3.0))
    assert said is not None
    assert said.theta[0] == pytest.approx(1.5 + 2 * 3.0)
    assert said.covariance[0, 0] == pytest.approx(0.5 + tuning.STEADY_WALK)
    assert said.sensitivity[0, 0] == pytest.approx(2.0)
    assert known.steady(estimate(9.0)) is None
    assert known.interrupted().steady(estimate(1.6)) is None


def test_readings_that_repeat_a_code_count_once_and_those_of_white_noise_each() -> None:
    rng = np.random.default_rng(4)
    white = np.round(rng.standard_normal(2000))
    changes = np.array([np.count_nonzero(np.diff(white)), 99, 0])
    np.testing.assert_allclose(by_repeats(changes, 2000), [1.0, 10.0, 1000.0])


def test_scatter_ratio_has_all_its_digits_where_parameters_and_constants_are_nearly_alike() -> None:
    """As differences of estimates with the constants open it had none: it moved by 20 to 80 % here."""
    rig, noise = ChainRig(), DenseNoise(np.full(2, 1e-8), np.zeros(2))
    learner = learner_of(rig, 400)
    at = linearised(learner, knowledge(learner, noise), record(rig, np.random.default_rng(3), noise, 400)[0])
    other = replace(
        at, Si=at.Si * (1 + 1e-10 * np.random.default_rng(4).standard_normal(len(at.Si)))[:, None, None]
    )
    np.testing.assert_allclose(learner._ratio(other), learner._ratio(at), rtol=1e-4)


def test_blocks_of_a_window_hold_all_that_its_bins_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, noise = ChainRig(), DenseNoise(np.full(2, 4e-4), np.zeros(2))
    learner = learner_of(rig, 400)
    known = knowledge(learner, noise)
    window = record(rig, np.random.default_rng(3), noise, 400)[0]
    at = linearised(learner, replace(known, kept=40), window)
    given: list[np.ndarray] = []
    monkeypatch.setattr(learning, "block_ratio", lambda blocks, *_: given.append(blocks))
    learner._ratio(at)
    alone = at.regression.layout.xi.start
    whole = at.G[:alone, :alone]
    np.testing.assert_allclose(
        given[0].sum(axis=0)[:alone, :alone], whole, rtol=1e-9, atol=1e-9 * np.abs(whole).max()
    )
