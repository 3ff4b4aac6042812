"""The filter against statsmodels' local linear trend; scores against scoringrules."""

import numpy as np
import pytest
import scoringrules
from statsmodels.tsa.statespace.structural import UnobservedComponents

from agent.prognosis.filter import State, Walk, run_filter
from agent.prognosis.scores import crps


def test_filter_likelihood_is_that_of_statsmodels(rng: np.random.Generator) -> None:
    y = np.cumsum(
        np.cumsum(0.1 * rng.standard_normal(80)) + 0.3 * rng.standard_normal(80)
    ) + rng.standard_normal(80)
    variances = np.array([[1.0, 0.09, 0.01], [0.3, 0.5, 1e-4], [2.0, 1e-6, 0.2]])  # ε, η, ζ
    ones = np.ones((79, 3))
    start = State(np.zeros(3), np.zeros(3), np.full(3, 100.0), np.zeros(3), np.full(3, 25.0))
    walk = Walk(ones, ones * variances[:, 1], ones * variances[:, 2], 0.0 * ones)
    state, found = run_filter(
        np.repeat(y[:, None], 3, axis=1), np.ones((80, 3)) * variances[:, 0], walk, start
    )
    for row, likelihood, level, rate in zip(variances, found, state.u, state.b, strict=True):
        model = UnobservedComponents(y, "local linear trend")
        model.ssm.initialize_known(np.zeros(2), np.diag([100.0, 25.0]))
        model.loglikelihood_burn = 0
        oracle = model.smooth(row)
        assert likelihood == pytest.approx(oracle.llf_obs.sum(), abs=1e-6)
        assert (level, rate) == pytest.approx(tuple(oracle.filtered_state[:, -1]), abs=1e-8)


def test_crps_is_that_of_scoringrules(rng: np.random.Generator) -> None:
    for _ in range(20):
        draws, came = rng.gamma(2.0, 30.0, 400), rng.gamma(2.0, 30.0)
        assert crps(draws, came) == pytest.approx(
            float(scoringrules.crps_ensemble(came, draws, estimator="nrg")), abs=1e-9
        )
