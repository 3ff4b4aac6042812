"""Noise of several sources at once: what a colour does at a window's ends, and variances sought together."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from agent.numerics.inference.learner import Learner
from agent.numerics.inference.noise.restricted_likelihood import NoiseFit, bounded
from agent.numerics.inference.posterior import Knowledge
from agent.numerics.inference.spectral.columns import Window, window_of
from agent.numerics.inference.spectral.sources import spectra
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import knowledge, learner_of, linearised
from tests.unit.numerics.inference.test_window_dense import SIGMA, apart, both

FloatArray = NDArray[np.float64]
SAMPLES = 600
COLOUR = 4e-4
FORCE_POLE = 0.97


def smooth(rig: ChainRig, rng: np.random.Generator, samples: int = SAMPLES) -> Window:
    """A window of a rig that is slow beside its samples, without noise: it is seen by its lowest bins."""
    u = rng.standard_normal(samples + 501)
    for _ in range(2):
        u = lfilter([1 - FORCE_POLE], [1, -FORCE_POLE], u)
    force = 20 * (u / u.std())[500:, None]
    x0 = 0.01 * rng.standard_normal(2 * rig.count)
    eta = np.zeros(rig.count + len(rig.seen) + 2)
    y = rig.readings(1.03 * rig.theta, eta, x0, force[1:], np.diff(force, axis=0)).real
    return window_of(y, force[1:], force[0])


def coloured(rng: np.random.Generator, pole: float, samples: int = SAMPLES) -> FloatArray:
    white = COLOUR * np.sqrt(1 - pole**2) * rng.standard_normal((samples + 1000, 2))
    return np.asarray(lfilter([1.0], [1, -pole], white, axis=0)[1000:])


@pytest.mark.parametrize("which", range(3))
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.soak) for seed in (1, 2))])
def test_noise_of_a_colour_is_dense_least_squares_where_the_motion_is_slow(which: int, seed: int) -> None:
    rig = ChainRig()
    learner = learner_of(rig, SAMPLES)
    pole = [s.pole for s in learner.sources if s.is_colour and s.number == 0][which]
    noise = DenseNoise(0.05 * SIGMA, np.zeros(2), (), ((0, pole, COLOUR), (1, pole, COLOUR)))
    _, known, at, dense = both(rig, noise, smooth(rig, np.random.default_rng(seed)))
    # without a column for the ends estimates are 0.6 to 11 sds apart, and these sds 1 to 15 % too small
    assert apart(at, known, dense)[0] < 2.0
    given = dense.solve(1e12 * np.eye(len(known.eta)), np.zeros(len(known.eta)))[1]
    ratio = np.sqrt(np.diag(at.given[1]) / np.diag(given)[: len(rig.theta)])
    assert np.abs(ratio - 1).max() < 0.07


def there(learner: Learner, noise: DenseNoise) -> Knowledge:
    """What is known, its sources there for sure."""
    known = knowledge(learner, noise)
    log_weight = known.noise.log_weight - 30.0 * (known.noise.intensity > 1e-30)[:, None] * [1, 0, 0, 0]
    return replace(known, noise=replace(known.noise, log_weight=log_weight))


def test_noise_score_of_variances_is_the_slope_of_the_restricted_likelihood() -> None:
    rig = ChainRig()
    learner = learner_of(rig, SAMPLES)
    pole = next(s.pole for s in learner.sources if s.is_colour)
    window = smooth(rig, np.random.default_rng(1))
    window = replace(window, y=window.y + SIGMA * np.random.default_rng(2).standard_normal((SAMPLES, 2)))
    colours = ((0, pole, 1e-4),)
    known = there(learner, DenseNoise(SIGMA, np.array([0.5, 0.0]), (), colours))
    quiet = knowledge(learner, DenseNoise(SIGMA, np.zeros(2)))
    at = linearised(learner, quiet, window)
    wide = learner.lineariser.ridge(
        at.regression.layout, window, learner.lineariser.wide(known.constants), np.zeros(len(known.eta))
    )
    fit = NoiseFit(known.noise, at.cells, at.regression, learner.sources, wide)
    assert {learner.sources[a].origin for a in fit.there} == {("force", 0), ("sensor", 0)}
    fit.refresh()
    residual, _, whole = fit._fitted()
    levels = fit.cells.weight[:, None] * fit.cells.cell_levels(fit.levels)
    score, _, own = fit._intensities(residual, whole, levels)
    checked = 0
    for i, a in enumerate(fit.there):
        if learner.sources[a].is_slow_force or fit.intensity[a] < 1e-30:
            continue
        found, variance = [], fit.intensity[a] ** 2
        for factor in (0.999, 1.001):
            fit.intensity[a] = np.sqrt(factor * variance)
            found.append(fit.restricted_log_likelihood())
        fit.intensity[a] = np.sqrt(variance)
        # but for what the ends tell of it: one number beside all of its bins
        slope = (found[1] - found[0]) / (0.002 * variance)
        assert score[i] == pytest.approx(slope, rel=0.01)
        assert own[i, i] > 0
        checked += 1
    assert checked == 2


@pytest.mark.parametrize("seed", range(50))
def test_noise_step_of_variances_is_the_best_within_its_bounds(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((4, 6))
    scale = 10.0 ** rng.uniform(-8, 0, 4)
    H = (A @ A.T) / np.outer(scale, scale)
    g = rng.standard_normal(4) / scale
    least = -rng.uniform(0, 1, 4) * scale
    x = bounded(H, g, least)
    assert np.all(x >= least * (1 + 1e-9))

    def cost(x: FloatArray) -> float:
        return float(0.5 * x @ H @ x - g @ x)

    best = np.inf
    for free in product((False, True), repeat=4):
        f, y = np.array(free), least.copy()
        y[f] = np.linalg.solve(H[np.ix_(f, f)], g[f] - H[np.ix_(f, ~f)] @ least[~f])
        if np.all(y >= least * (1 + 1e-9)):
            best = min(best, cost(y))
    assert cost(x) == pytest.approx(best, rel=1e-9)


def test_noise_between_two_corners_is_learnt_as_it_is() -> None:
    """AR(0.95): between the corners of the model, neither of which fits, nor white noise beside them."""
    rig, rng = ChainRig(), np.random.default_rng(3)
    learner = learner_of(rig, SAMPLES)
    known = learner.prior(np.full(2, COLOUR), np.full(2, 0.3))
    errors = []
    for _ in range(40):
        window = smooth(rig, rng)
        said, known = learner.learn(replace(window, y=window.y + coloured(rng, 0.95)), known)
        errors.append((said.theta - 1.03 * rig.theta) / said.sd_repeat)
    z = np.exp(2j * np.pi * np.arange(2, SAMPLES // 4) / SAMPLES)
    noise = known.noise
    for output in range(2):
        spectrum = np.exp(2 * noise.log_sigma[output]) * np.ones(len(z))
        for a, source in enumerate(learner.sources):
            if source.is_colour and source.number == output:
                spectrum += noise.intensity[a] ** 2 * spectra((source,), z)[0]
        true = COLOUR**2 * (1 - 0.95**2) / np.abs(1 - 0.95 / z) ** 2
        # one intensity after the other 0.12 to 0.16
        assert np.sqrt(np.mean(np.log(spectrum / true) ** 2)) < 0.1
    assert np.sqrt(np.mean(np.square(errors[8:]))) == pytest.approx(1.0, abs=0.25)
