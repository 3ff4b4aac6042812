"""Whether one more column is evident: against least squares by hand."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from agent.numerics.inference.friction import Friction, columns, frictions
from agent.numerics.inference.learner import Learner
from agent.numerics.inference.spectral.algebra import inverse
from agent.numerics.inference.spectral.response import Response
from agent.numerics.model.uncertain import Rubbing
from tests.unit.numerics.inference.chain import ChainRig, DenseNoise
from tests.unit.numerics.inference.frequency import W, record

SIZE = 0.7


def gram_of(rng: np.random.Generator, more: np.ndarray | None, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Gram of [three columns, one more, residual] in 300 samples; the residual holds the one more so many
    times."""
    base = rng.standard_normal((300, 3))
    column = rng.standard_normal(300) if more is None else base @ more
    residual = base @ np.array([1.0, -2.0, 0.5]) + size * column + 0.1 * rng.standard_normal(300)
    X = np.column_stack([base, column, residual]) / 0.1
    return X.T @ X, X


def weighed(gram: np.ndarray) -> Friction:
    V = inverse(gram[:3, :3])
    cross = gram[[0, 1, 2, 4], 3:4]
    (found,) = frictions(gram[3:4, 3], cross, V, V @ gram[:3, 4], slice(0, 2), 300.0, 1.0)
    return found


def test_friction_is_the_least_squares_size_of_its_column(rng: np.random.Generator) -> None:
    gram, X = gram_of(rng, None, SIZE)
    found = weighed(gram)
    wanted, (with_it,) = np.linalg.lstsq(X[:, :4], X[:, 4], rcond=None)[:2]
    alone, (without,) = np.linalg.lstsq(X[:, :3], X[:, 4], rcond=None)[:2]
    assert found.size == pytest.approx(wanted[3])
    assert found.evidence == pytest.approx(0.5 * (without - with_it) - 0.5 * np.log(300))
    assert found.shift == pytest.approx((wanted[:3] - alone)[:2])


def test_friction_that_drives_is_none(rng: np.random.Generator) -> None:
    gram, _ = gram_of(rng, None, -SIZE)
    found = weighed(gram)
    assert found.evidence == -np.inf


@pytest.mark.parametrize("more", [np.array([1.0, 1.0, -3.0]), np.zeros(3)])
def test_friction_column_that_the_model_has_already_is_no_evidence(
    rng: np.random.Generator, more: np.ndarray
) -> None:
    for _ in range(20):  # what rounding leaves of it has either sign
        gram, _ = gram_of(rng, more, SIZE)
        found = weighed(gram)
        assert found.evidence == -np.inf
        assert found.size == 0


def test_friction_is_sought_by_motions_in_metres(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """States are in units of one size elsewhere; displacements are what is read."""
    chain = ChainRig(masses=(0.5, 40.0), springs=(2000.0, 300.0))
    across = Rubbing(np.array([1.0, -1.0, 0.0, 0.0]), np.array([1.0, -1.0]))
    learner = Learner(replace(chain.rig, rubbings=(across,)), W, 2, np.zeros(2))
    assert len(set(learner.rig.sizes.tolist())) > 1
    seen = []

    def asked(response: Response, states: np.ndarray, *others: Any) -> np.ndarray:
        seen.append(np.fft.irfft(states, W, axis=0) * np.sqrt(W))
        return columns(response, states, *others)

    monkeypatch.setattr("agent.numerics.inference.learner.columns", asked)
    noise = DenseNoise(np.array([1e-5, 1e-5]), np.zeros(2))
    window = record(chain, rng, noise)[0]
    learner.learn(window, learner.prior(noise.sigma, np.full(2, 0.3)))
    apart = (seen[-1][:, 2:] - window.y)[10:-10]
    assert np.abs(apart).max() < 0.1 * np.abs(window.y).max()
