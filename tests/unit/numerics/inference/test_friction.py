"""Whether one more column is evident: against least squares by hand."""

import numpy as np
import pytest

from agent.numerics.inference.friction import Friction, frictions
from agent.numerics.inference.spectral.algebra import inverse

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
