"""Small dense algebra where rounding is as large as what is looked for."""

import numpy as np
import pytest

from agent.numerics.inference.spectral.algebra import inverse, root, shown


def nearly_singular(
    rng: np.random.Generator, k: int = 12
) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """A Gram of columns from 1e-8 to 1e8, of rank 6, that rounding left indefinite."""
    X = rng.standard_normal((50, 6)) @ rng.standard_normal((6, k)) * np.logspace(-8, 8, k)
    M = np.asarray(X.T @ X)
    error = 1e-12 * rng.standard_normal((k, k)) * np.sqrt(np.outer(np.diag(M), np.diag(M)))
    return M + error + error.T


def test_inverse_of_what_rounding_left_indefinite_has_no_negative_variance(rng: np.random.Generator) -> None:
    for _ in range(20):
        M = nearly_singular(rng)
        d = 1 / np.sqrt(np.diag(M))
        assert np.linalg.eigvalsh(M * np.outer(d, d))[0] < -1e-13
        assert (np.diag(inverse(M)) > 0).all()
        assert (np.einsum("jii->ji", inverse(np.array([M, np.eye(12)]))) > 0).all()


def test_inverse_of_columns_of_very_different_size_is_the_inverse(rng: np.random.Generator) -> None:
    X = rng.standard_normal((50, 8)) * np.logspace(-9, 9, 8)
    d = np.logspace(-9, 9, 8)
    np.testing.assert_allclose(
        inverse(X.T @ X) * np.outer(d, d), np.linalg.inv((X / d).T @ (X / d)), rtol=1e-9
    )


@pytest.mark.parametrize("rank", [3, 5])
def test_root_of_a_covariance_gives_it_back_where_it_is_singular_too(
    rank: int, rng: np.random.Generator
) -> None:
    F = rng.standard_normal((5, rank)) * np.logspace(-6, 2, 5)[:, None]
    P, scale = F @ F.T, np.logspace(-6, 2, 5)
    found = root(P)
    np.testing.assert_allclose(
        (found @ found.T) / np.outer(scale, scale), P / np.outer(scale, scale), atol=1e-12
    )


def test_shown_leaves_what_data_show_and_takes_what_is_only_rounding() -> None:
    whole = np.array([1e16, 1e16, 1.0])
    S = np.diag([4e6, -3.0, 0.5])
    kept, score = shown(S, np.array([1.0, 2.0, 3.0]), whole)
    np.testing.assert_allclose(kept, np.diag([4e6, 0.0, 0.5]), atol=1e-6)
    np.testing.assert_allclose(score, [1.0, 0.0, 3.0], atol=1e-9)
