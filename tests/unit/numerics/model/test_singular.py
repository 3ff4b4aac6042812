"""Singular values of graded matrices, on which divide and conquer fails."""

import numpy as np
import pytest

from agent.numerics.model.singular import leading, singular
from agent.types import FloatArray


def graded(seed: int, size: int = 120) -> FloatArray:
    """A triangular factor like those of the bank: columns of unit length, values over twenty decades."""
    rng = np.random.default_rng(seed)
    left, right = (np.linalg.qr(rng.standard_normal((size, size)))[0] for _ in range(2))
    factor = np.linalg.qr(left * np.geomspace(1.0, 1e-20, size) @ right, mode="r")
    return np.asarray(factor / np.linalg.norm(factor, axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_singular_values_give_the_matrix_again(seed: int) -> None:
    matrix = graded(seed)[:, :100]
    left, values, right = singular(matrix)
    assert (left.shape, values.shape, right.shape) == ((120, 100), (100,), (100, 100))
    assert np.abs(left * values @ right - matrix).max() < 1e-14
    assert np.abs(right @ right.T - np.eye(100)).max() < 1e-13
    assert np.all(np.diff(values) <= 0)


@pytest.mark.parametrize("seed", range(5))
def test_leading_values_are_those_of_all_beyond_the_least(seed: int) -> None:
    matrix = graded(seed)
    values, right = leading(matrix, 1e-10)
    _, every, _ = singular(matrix)
    assert len(values) == (every > 1e-10 * every[0]).sum()
    assert np.abs(values - every[: len(values)]).max() < 1e-10 * every[0]
    kept = values[:, None] * right
    assert np.abs(kept.T @ kept - matrix.T @ matrix).max() < 1e-14 * every[0] ** 2
    assert np.abs(right @ right.T - np.eye(len(values))).max() < 1e-13


def test_what_is_no_number_is_an_error_of_linear_algebra() -> None:
    with pytest.raises(np.linalg.LinAlgError, match="no number"):
        singular(np.array([[1.0, np.nan]]))
