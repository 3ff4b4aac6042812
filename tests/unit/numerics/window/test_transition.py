"""The filters' step by its blocks: what single blocks give is what the whole matrix does."""

import numpy as np
import pytest

from agent.numerics.window.filtering.transition import Transition


def transition(a: int = 4, n: int = 3, c: int = 2) -> Transition:
    rng = np.random.default_rng(a + n + c)
    blocks = rng.standard_normal((a, a)), rng.standard_normal((n, n)), rng.standard_normal((c, a, n))
    return Transition(0.4 * blocks[0], 0.4 * blocks[1], blocks[2])


@pytest.mark.parametrize("count", [0, 1, 2, 5, 8, 531])
def test_power_is_that_of_the_whole_matrix(count: int) -> None:
    one = transition()
    whole = np.linalg.matrix_power(one.whole(), count)
    np.testing.assert_allclose(one.power(count).whole(), whole, rtol=1e-11, atol=1e-14)
    of_responses = np.linalg.matrix_power(one.of_responses(), count)
    np.testing.assert_allclose(one.power(count).of_responses(), of_responses, rtol=1e-11, atol=1e-14)


def test_after_takes_what_came_first_on_the_right() -> None:
    first, then = transition(), transition(4, 3, 2).power(3)
    np.testing.assert_allclose(then.after(first).whole(), then.whole() @ first.whole())


def test_responses_are_what_the_whole_state_shows() -> None:
    one = transition()
    a, n, c, p = 4, 3, 2, 2
    rng = np.random.default_rng(3)
    gamma, drift = rng.standard_normal((p, a)), rng.standard_normal((c, p, n))
    Gamma, D = one.responses(gamma, drift, 6)
    for k in range(6):
        F = np.linalg.matrix_power(one.whole(), k)
        np.testing.assert_allclose(Gamma[k], gamma @ F[n : n + a, n : n + a], rtol=1e-12)
        for i in range(c):
            seen = np.zeros((p, len(F)))
            seen[:, :n], seen[:, n + a + i * a : n + a + (i + 1) * a] = drift[i], gamma
            np.testing.assert_allclose(D[k, :, i], (seen @ F)[:, :n], rtol=1e-11, atol=1e-14)
    G = [np.hstack([Gamma[k], D[k].reshape(p, -1)]) for k in range(6)]
    np.testing.assert_allclose(G[5], G[4] @ one.of_responses(), rtol=1e-11, atol=1e-14)
