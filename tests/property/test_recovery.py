"""Noise-free records of random rigs: whatever they are made of, the fit finds it to the last digits."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from agent.numerics.fitting.fit import FittedModel, fit_window
from agent.numerics.inference.spectral.columns import window_of
from agent.numerics.model.statespace import discretise
from tests.unit.numerics.rigs import disturbance, measured_model, random_structure, record


@settings(max_examples=20)
@given(masses=st.integers(1, 6), seed=st.integers(0, 2**32 - 1))
@example(masses=6, seed=0)
@example(masses=6, seed=1)
@example(masses=1, seed=2)
def test_fit_window_noise_free_random_graph_is_recovered(masses: int, seed: int) -> None:
    """1-6 masses in a tree or ring, every displacement measured, a force on each, steps of up to half of
    nominal."""
    rng = np.random.default_rng(seed)
    model = measured_model(random_structure(rng, masses), tuple(f"m{i + 1}" for i in range(masses)))
    nominal = model.nominal
    theta = nominal * rng.uniform(0.5, 1.5, len(nominal))
    speeds = np.abs(np.linalg.eigvals(model.continuous(np.maximum(theta, nominal)).A))
    period, samples = 0.2 / speeds.max(), 1500

    truth = record(discretise(model.continuous(theta), period), rng.standard_normal((samples, masses)))
    sigma = np.full(masses, 1e-6 * np.sqrt(np.mean(truth.y**2)))
    problem = FittedModel(model, period, "first", disturbance(model), sigma, nominal, 0.02 * nominal)
    fit = fit_window(problem, window_of(truth.y, truth.u), nominal)
    np.testing.assert_allclose(fit.theta, theta, rtol=1e-8)
    assert fit.converged
