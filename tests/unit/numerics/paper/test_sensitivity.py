"""The joint filter against the plain recursion, and its sensitivities against finite differences of the
observer."""

import numpy as np
import pytest

from agent.numerics.model.statespace import StateSpace, discretise
from agent.numerics.paper.sensitivity import sensitivity_filter
from tests.unit.numerics.model.test_statespace import widest_model
from tests.unit.numerics.rigs import FloatArray


def innovations(model: StateSpace, gain: FloatArray, y: FloatArray, u: FloatArray) -> FloatArray:
    x, e = np.zeros(model.n), np.empty_like(y)
    for k in range(len(y)):
        e[k] = y[k] - model.C @ x - model.D @ u[k]
        x = model.A @ x + model.B @ u[k] + gain @ e[k]
    return e


@pytest.mark.parametrize("gain_size", [0.0, 0.05])
def test_sensitivity_filter_widest_model_equals_recursion_and_its_slopes(
    gain_size: float, rng: np.random.Generator
) -> None:
    model, T, N = widest_model(), 0.02, 60
    d = discretise(model.continuous(model.nominal), T).model
    gain = gain_size * rng.standard_normal((d.n, d.p))
    y, u = rng.standard_normal((N, d.p)), rng.standard_normal((N, d.m))
    f = sensitivity_filter(d, gain)
    z, o = np.zeros(len(f.F)), []
    for v in np.hstack([y, u]):
        o.append((f.H @ z + f.J @ v).reshape(d.p, 1 + d.q))
        z = f.F @ z + f.N @ v
    outputs = np.array(o)
    np.testing.assert_allclose(outputs[:, :, 0], innovations(d, gain, y, u), atol=1e-10)
    for i, size in enumerate(model.nominal):
        step = np.eye(d.q)[i] * 1e-5 * size
        above, below = (discretise(model.continuous(model.nominal + s * step), T).model for s in (1, -1))
        # psi is the slope of the prediction y - e
        slope = (innovations(below, gain, y, u) - innovations(above, gain, y, u)) / (2 * step[i])
        np.testing.assert_allclose(outputs[:, :, 1 + i], slope, atol=1e-6 * max(1.0, np.abs(slope).max()))
