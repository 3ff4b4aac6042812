"""What windows say together: accumulated with forgetting, one at a time or many; contradiction forgets the past."""

import numpy as np

from agent.numerics.window.reference import FORGET, Reference, combined, mean_and_sd
from tests.unit.numerics.rigs import FloatArray


def informations(rng: np.random.Generator, count: int) -> FloatArray:
    roots = rng.standard_normal((count, 2, 2))
    return roots @ roots.transpose(0, 2, 1) + np.eye(2)


def test_reference_many_windows_at_once_equal_one_at_a_time(rng: np.random.Generator) -> None:
    H, theta = informations(rng, 7), rng.standard_normal((7, 2))
    start = Reference(np.eye(2), np.array([1.0, -1.0]))
    A, b = start.with_windows(H, theta)
    one = start
    for k in range(7):
        one = Reference(FORGET * one.A + H[k], FORGET * one.b + H[k] @ theta[k])
        np.testing.assert_allclose(A[k], one.A)
        np.testing.assert_allclose(b[k], one.b)


def test_mean_and_sd_is_the_weighted_mean_and_infinite_where_nothing_is_known(rng: np.random.Generator) -> None:
    H, theta = informations(rng, 3), np.array([[1.0, 2.0], [1.1, 1.9], [0.9, 2.2]])
    A, b = Reference.empty(2).with_windows(H, theta)
    mean, sd = mean_and_sd(A[-1:], b[-1:])
    weights = FORGET ** np.array([2, 1, 0])
    total = np.einsum("n,nij->ij", weights, H)
    np.testing.assert_allclose(mean[0], np.linalg.solve(total, np.einsum("n,nij,nj->i", weights, H, theta)))
    np.testing.assert_allclose(sd[0], np.sqrt(np.diag(np.linalg.inv(total))))
    _, unknown = mean_and_sd(np.diag([4.0, 0.0])[None], np.zeros((1, 2)))
    np.testing.assert_allclose(unknown[0], [0.5, np.inf])


def test_combined_agreeing_windows_are_averaged_and_a_contradiction_forgets() -> None:
    past, H = Reference(np.diag([100.0, 100.0]), np.array([100.0, 100.0])), np.diag([100.0, 100.0])
    centre, after = combined(past, H, np.array([1.1, 0.9]))
    np.testing.assert_allclose(centre, [1.05, 0.95])
    np.testing.assert_allclose(after.A, 2 * H)
    centre, after = combined(past, H, np.array([2.0, 1.0]))
    np.testing.assert_allclose(centre, [2.0, 1.0])
    np.testing.assert_allclose(after.A, H)
    centre, after = combined(Reference.empty(2), H, np.array([3.0, 4.0]))
    np.testing.assert_allclose(centre, [3.0, 4.0])
